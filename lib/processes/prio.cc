// SPDX-License-Identifier: Apache-2.0
#include "processes/prio.h"

#include "model/platform.h"

namespace xauto::runtime {
namespace {

Ordered ordered_of(const XNodeLine& line) {
  const std::uint32_t ordered = line.ordered.load();
  return ordered > static_cast<std::uint32_t>(Ordered::kRank) ? Ordered::kNobody
                                                              : static_cast<Ordered>(ordered);
}

XNodeLine* find(Board& board, std::string_view xnode) {
  for (std::uint32_t n = 0; n < board.shape().nodes; ++n)
    if (line_name(board.xnode(n).name) == xnode.substr(0, kBoardNameBytes - 1))
      return &board.xnode(n);
  return nullptr;
}

Result<XNodeLine*> line_of(Board& board, std::string_view xnode) {
  XNodeLine* line = find(board, xnode);
  if (line == nullptr)
    return fail(ErrorCode::kNotFound, "the app has no XNode '" + std::string(xnode) + "'", {},
                "`xauto prio` lists them");
  const std::string where = "XNode '" + std::string(xnode) + "'";
  if (ordered_of(*line) == Ordered::kNobody)
    return fail(ErrorCode::kUnavailable, "nobody schedules its jobs in this run", where,
                "start the run with --scheduling xauto");
  if (ordered_of(*line) == Ordered::kRank)
    return fail(ErrorCode::kUnavailable,
                "is on a core whose order Linux keeps by ranks, which were set before the run",
                where, "start the run with --cpu-sched ext, or with a policy of keys");
  return line;
}

}  // namespace

Status ask_for_urgency(Board& board, std::string_view xnode, const AskedUrgency& asked) {
  XAUTO_ASSIGN(XNodeLine* const line, line_of(board, xnode));
  const std::string where = "XNode '" + std::string(xnode) + "'";
  const bool keys = ordered_of(*line) == Ordered::kKey;
  if (asked.value && keys != asked.is_key)
    return fail(ErrorCode::kInvalid,
                keys ? "has a key: by when after its release a job is done"
                     : "has a priority: the larger number goes first",
                where, keys ? "give a time, as in 12ms" : "give a number");
  const std::int64_t least = keys ? 0 : -kMaxAskedPriority,
                     most = keys ? kMaxTimeUs : kMaxAskedPriority;
  if (asked.value && (*asked.value < least || *asked.value > most))
    return fail(ErrorCode::kInvalid,
                std::to_string(*asked.value) + " is not from " + std::to_string(least) + " to " +
                    std::to_string(most),
                where);
  line->asked.store(asked.value.value_or(XNodeLine::kAsPlanned));
  line->asked_times.fetch_add(1);
  return {};
}

Result<Json> change_urgency(const Json& asked, Board* board) {
  const auto name = asked.at("xnode").text();
  AskedUrgency urgency{.value = std::nullopt, .is_key = asked.has("key_us")};
  const char* const key = urgency.is_key ? "key_us" : "priority";
  if (asked.has(key)) urgency.value = asked.at(key).integer();
  if (!name || name->size() > kMaxNameBytes || asked.has(key) != urgency.value.has_value() ||
      (asked.has("key_us") && asked.has("priority")))
    return fail(ErrorCode::kInvalid, "the request is malformed", {},
                "the run and the xauto tool must be of one build");
  if (board == nullptr) return fail(ErrorCode::kUnavailable, "the app has not started yet");
  const XNodeLine* const line = find(*board, *name);
  const std::int64_t before = line == nullptr ? XNodeLine::kAsPlanned : line->asked.load();
  XAUTO_TRY(ask_for_urgency(*board, *name, urgency));
  Json was = {{"xnode", *name}};
  if (before != XNodeLine::kAsPlanned)
    was[ordered_of(*line) == Ordered::kKey ? "key_us" : "priority"] = before;
  Json answer = Json::object();
  answer["was"] = std::move(was);
  return answer;
}

std::vector<ShownUrgency> urgencies(const Board& board) {
  std::vector<ShownUrgency> all;
  for (std::uint32_t n = 0; n < board.shape().nodes; ++n) {
    const XNodeLine& line = board.xnode(n);
    const std::int64_t asked = line.asked.load();
    all.push_back({line_name(line.name), line_name(line.module), ordered_of(line),
                   line.planned.load(), line.keys.load() > 1,
                   asked == XNodeLine::kAsPlanned ? std::nullopt : std::optional(asked),
                   line.asked_times.load()});
  }
  return all;
}

}  // namespace xauto::runtime
