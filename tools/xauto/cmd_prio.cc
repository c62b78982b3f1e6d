// SPDX-License-Identifier: Apache-2.0
// xauto prio: how urgent one XNode of a run that goes on is, and to change it. Read from the run's counts; to change it
// the run's tool is asked.
#include <iostream>

#include <fmt/format.h>

#include "base/columns.h"
#include "base/utf8.h"
#include "model/json_value.h"
#include "model/platform.h"
#include "processes/prio.h"

#include "xauto/command.h"
#include "xauto/live.h"

namespace xauto::cli {
namespace {

using runtime::Ordered;
using runtime::ShownUrgency;

struct PrioFlags {
  std::string xnode, run;
  std::vector<std::int64_t> priority, key_us;  ///< none or one
  bool planned = false;
  int wait_s = 0;
};

const char* name_of(Ordered ordered) {
  switch (ordered) {
    case Ordered::kPriority:
      return "priority";
    case Ordered::kKey:
      return "key";
    case Ordered::kRank:
      return "rank";
    case Ordered::kNobody:
      break;
  }
  return "unscheduled";
}

std::string shown(Ordered ordered, std::int64_t value) {
  if (ordered == Ordered::kNobody) return "-";
  return ordered == Ordered::kKey ? ms(value) : std::to_string(value);
}

Result<int> list(const Watched& run, const Options& options) {
  const std::vector<ShownUrgency> all = runtime::urgencies(*run.board);
  if (options.json) {
    Json xnodes = Json::array();
    for (const ShownUrgency& one : all) {
      const bool scheduled = one.ordered != Ordered::kNobody;
      xnodes.push_back({{"xnode", one.xnode},
                        {"module", one.module},
                        {"by", name_of(one.ordered)},
                        {one.ordered == Ordered::kKey ? "planned_us" : "planned",
                         scheduled ? Json(one.planned) : Json()},
                        {one.ordered == Ordered::kKey ? "asked_us" : "asked",
                         one.asked ? Json(*one.asked) : Json()},
                        {"changes", one.changes}});
    }
    std::cout << Json{{"run", run.run}, {"app", run.app}, {"xnodes", std::move(xnodes)}}.dump(2)
              << "\n";
    return kDone;
  }
  std::cout << row_of("XNode", kNameColumns)
            << fmt::format("{:<12}{:>14}{:>14}\n", "by", "planned", "asked");
  for (const ShownUrgency& one : all)
    std::cout << row_of(one.xnode, kNameColumns)
              << fmt::format("{:<12}{:>14}{:>14}\n", name_of(one.ordered),
                             shown(one.ordered, one.planned) + (one.several ? ", ..." : ""),
                             one.asked ? shown(one.ordered, *one.asked) : "-");
  return kDone;
}

Result<int> change(const PrioFlags& flags, const Watched& run, const Options& options) {
  Json request = {{"xnode", flags.xnode}};
  if (!flags.priority.empty()) request["priority"] = flags.priority.front();
  if (!flags.key_us.empty()) request["key_us"] = flags.key_us.front();
  XAUTO_ASSIGN(const Json was, ask_desk(run, request));
  if (options.json) {
    std::cout << Json{{"was", was}}.dump() << "\n";
    return kDone;
  }
  const auto words = [](const Json& of) -> std::string {
    if (const auto priority = of.at("priority").integer()) return std::to_string(*priority);
    if (const auto key = of.at("key_us").integer()) return ms(*key);
    return "as planned";
  };
  std::cout << for_terminal(flags.xnode) << ": " << words(was) << " -> " << words(request)
            << ", from its next job on. Nothing is claimed of this run any more.\n";
  return kDone;
}

Result<int> prio(const PrioFlags& flags, const Options& options) {
  const std::size_t asked = flags.priority.size() + flags.key_us.size() + (flags.planned ? 1 : 0);
  if (flags.xnode.empty() && asked > 0)
    return fail(ErrorCode::kInvalid, "needs an XNode", "xauto prio",
                "xauto prio XNODE N, xauto prio XNODE --key 12ms");
  if (!flags.xnode.empty() && asked != 1)
    return fail(ErrorCode::kInvalid, "needs one of a priority, --key and --planned",
                "xauto prio " + flags.xnode, "`xauto prio` alone lists all XNodes");
  XAUTO_ASSIGN(const Watched run, find_run(flags.run, flags.wait_s));
  return asked == 0 ? list(run, options) : change(flags, run, options);
}

}  // namespace

void add_prio(Commands& commands) {
  auto flags = std::make_shared<PrioFlags>();
  Verb verb = commands.add(
      "prio",
      "Show how urgent the XNodes of a run that goes on are, and change one; nothing is claimed of "
      "the run then.",
      "xauto prio\n  xauto prio fcd.infer 7\n  xauto prio fcd.infer --key 12ms\n"
      "  xauto prio fcd.infer --planned",
      [flags](const Options& options) { return prio(*flags, options); });
  verb.option("xnode", flags->xnode, "whose jobs; without it all are listed");
  verb.option("priority", flags->priority,
              "in a run by priorities: from its next job on; the larger goes first")
      .values(1);
  verb.duration("--key", flags->key_us, Unit::kMicroseconds, 0, static_cast<double>(kMaxTimeUs),
                "in a run by keys: so long after its release each job is to be done");
  verb.flag("--planned", flags->planned, "the policy's is back");
  verb.option("--run", flags->run, "which run, where several go on");
  verb.duration("--wait", flags->wait_s, Unit::kSeconds, 0, kYearS,
                "how long to wait for a run to begin");
}

}  // namespace xauto::cli
