// SPDX-License-Identifier: Apache-2.0
#include "processes/prio.h"

#include "model/app.h"
#include "model/platform.h"

namespace xauto::runtime {
namespace {

/// What is asked of an XNode.
struct AskedUrgency {
  /// Of a policy of priorities; of a policy of keys microseconds from the nominal release. Nullopt: as planned.
  std::optional<std::int64_t> value;
  bool is_key = false;  ///< which of the two `value` is
};

Ordered ordered_of(const XNodeLine& line) {
  const std::uint32_t ordered = line.ordered.load();
  return ordered > static_cast<std::uint32_t>(Ordered::kRank) ? Ordered::kNobody
                                                              : static_cast<Ordered>(ordered);
}

Result<XNodeLine*> line_of(Board& board, std::string_view xnode) {
  XNodeLine* line = nullptr;
  for (std::uint32_t n = 0; n < board.shape().nodes && line == nullptr; ++n)
    if (line_name(board.xnode(n).name) == xnode.substr(0, kBoardNameBytes - 1))
      line = &board.xnode(n);
  if (line == nullptr)
    return fail(ErrorCode::kNotFound, "the app has no XNode '" + std::string(xnode) + "'", {},
                "`xauto prio` lists them");
  const std::string where = "XNode '" + std::string(xnode) + "'";
  if (ordered_of(*line) == Ordered::kNobody)
    return fail(ErrorCode::kUnavailable, "nobody schedules its jobs in this run", where,
                "start it with --scheduling xauto; on a real core SCHED_FIFO has to be permitted, "
                "or --cpu-sched ext (`xauto doctor`)");
  if (ordered_of(*line) == Ordered::kRank)
    return fail(ErrorCode::kUnavailable,
                "is on a core whose order Linux keeps by ranks, which were set before the run",
                where, "start the run with --cpu-sched ext, or with a policy of keys");
  return line;
}

/// What was asked of it before.
Result<std::int64_t> ask(XNodeLine& line, std::string_view xnode, const AskedUrgency& asked) {
  const std::string where = "XNode '" + std::string(xnode) + "'";
  const bool keys = ordered_of(line) == Ordered::kKey;
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
  const std::int64_t before = line.asked.exchange(asked.value.value_or(XNodeLine::kAsPlanned));
  line.asked_times.fetch_add(1);
  return before;
}

}  // namespace

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
  XAUTO_ASSIGN(XNodeLine* const line, line_of(*board, *name));
  XAUTO_ASSIGN(const std::int64_t before, ask(*line, *name, urgency));
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
