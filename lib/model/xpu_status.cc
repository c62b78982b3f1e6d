// SPDX-License-Identifier: Apache-2.0
#include "model/xpu_status.h"

#include <algorithm>
#include <optional>

namespace xauto {
namespace {

std::optional<Discipline> discipline_from(const std::string& name) {
  for (const Discipline d :
       {Discipline::kPreemptive, Discipline::kGate, Discipline::kKernel, Discipline::kLevels})
    if (name == to_string(d)) return d;
  return std::nullopt;
}

std::uint64_t count(const Json& json) {
  return static_cast<std::uint64_t>(std::max<std::int64_t>(0, json.integer().value_or(0)));
}

}  // namespace

Json to_json(const XpuStatus& status) {
  Json workers = Json::array();
  for (const WorkerStatus& w : status.workers) {
    Json worker = {{"worker", w.worker}, {"state", w.state}};
    if (!w.idle()) {
      worker["xnode"] = w.xnode;
      worker["job"] = w.job;
      if (w.due_us)
        worker["due_us"] = *w.due_us;
      else
        worker["priority"] = w.priority;
      worker["since_us"] = w.since_us;
      if (!w.by.empty()) worker["by"] = w.by;
    }
    workers.push_back(std::move(worker));
  }
  return {{"xpu", status.xpu},
          {"pid", status.pid},
          {"discipline", to_string(status.discipline)},
          {"mode", status.arbitrated ? "arbitrated" : "uncontended"},
          {"looks", status.looks},
          {"decisions", status.decisions},
          {"workers", std::move(workers)}};
}

Result<XpuStatus> parse_xpu_status(const Json& json) {
  const auto bad = [](const std::string& what) {
    return fail(ErrorCode::kInvalid, "a coordinator answered without " + what, {},
                "use xauto-coordinator and xauto of one build");
  };
  XpuStatus status;
  const auto xpu = json.at("xpu").text();
  const auto discipline = discipline_from(json.at("discipline").text().value_or(""));
  if (!xpu) return bad("its XPU");
  if (!discipline) return bad("its discipline");
  status.xpu = *xpu;
  status.discipline = *discipline;
  status.pid = json.at("pid").integer().value_or(0);
  status.arbitrated = json.at("mode").text() == std::optional<std::string>("arbitrated");
  status.looks = count(json.at("looks"));
  status.decisions = count(json.at("decisions"));
  for (const Json& w : json.at("workers").elements()) {
    const auto worker = w.at("worker").text(), state = w.at("state").text();
    if (!worker || !state) return bad("a worker's name and state");
    status.workers.push_back({*worker, *state, w.at("xnode").text().value_or(""),
                              count(w.at("job")), w.at("priority").integer().value_or(0),
                              count(w.at("since_us")), w.at("by").text().value_or(""),
                              w.at("due_us").integer()});
  }
  return status;
}

}  // namespace xauto
