// SPDX-License-Identifier: Apache-2.0
#include "processes/mode.h"

#include <optional>

#include "model/json_value.h"
#include "processes/parameters.h"
#include "processes/prio.h"

namespace xauto::runtime {
namespace {

Result<Json> change_mode(const Json& asked, Board* board) {
  const auto name = asked.at("mode").text();
  if (!name || name->size() > kMaxNameBytes)
    return fail(ErrorCode::kInvalid, "the request is malformed", {},
                "the run and the xauto tool must be of one build");
  if (board == nullptr) return fail(ErrorCode::kUnavailable, "the app has not started yet");
  const std::uint32_t before = board->header().asked.load();
  XAUTO_TRY(ask_for_scenario(*board, *name));
  Json was = Json::object();
  was["mode"] = before > 0 && before <= board->shape().scenarios
                    ? line_name(board->scenario(before - 1).name)
                    : std::string();
  Json answer = Json::object();
  answer["was"] = std::move(was);
  return answer;
}

}  // namespace

Status ask_for_scenario(Board& board, std::string_view name) {
  const std::uint32_t scenarios = board.shape().scenarios;
  if (scenarios == 0)
    return fail(ErrorCode::kUnavailable, "the run has one policy, so there are no scenarios", {},
                "start it with the tables of `xauto solve --scenarios`");
  if (name.empty()) {
    board.header().asked.store(0);
    return {};
  }
  for (std::uint32_t s = 0; s < scenarios; ++s)
    if (line_name(board.scenario(s).name) == name.substr(0, kBoardNameBytes - 1)) {
      board.header().asked.store(s + 1);
      return {};
    }
  return fail(ErrorCode::kNotFound, "there is no scenario '" + std::string(name) + "'", {},
              "`xauto param` lists them");
}

std::string answer_request(std::string_view request, Board* board) {
  const std::optional<Json> asked = Json::parse(request);
  if (asked && asked->has("xnode")) return to_answer(change_urgency(*asked, board));
  if (!asked || !asked->has("mode")) return change_parameters(request, board);
  return to_answer(change_mode(*asked, board));
}

}  // namespace xauto::runtime
