// SPDX-License-Identifier: Apache-2.0
#include "xauto/machine.h"

#include <algorithm>
#include <set>
#include <utility>

#include <fmt/format.h>

#include "base/columns.h"
#include "base/utf8.h"
#include "launch/system_lease.h"
#include "story/perfetto.h"

namespace xauto::cli {
namespace {

constexpr std::size_t kMostRecorded = 2'000'000;  ///< of an XPU, in one file

std::string text_of(const Json& value) {
  return for_terminal(value.text().value_or("?"), false);
}

std::string app_of(const Json& app) {
  return fmt::format("{} (uid {})", text_of(app.at("app")), app.at("uid").integer().value_or(-1));
}

/// Of app `lease` on `xpu`; null: it is not there.
const Json* find_on(const Json& machine, std::int64_t lease, const Json& xpu) {
  for (const Json& app : machine.at("apps").elements())
    if (app.at("lease").integer() == lease)
      for (const Json& on : app.at("xpus").elements())
        if (on.at("xpu").text() == xpu.text()) return &on;
  return nullptr;
}

std::optional<double> had_pct(const Json& now, const Json& before, std::int64_t lease,
                              const Json& on) {
  const Json* then = find_on(before, lease, on.at("xpu"));
  if (then == nullptr) return std::nullopt;
  const auto since = [](const Json& later, const Json& sooner, const char* key) {
    return later.at(key).integer().value_or(0) - sooner.at(key).integer().value_or(0);
  };
  const std::int64_t us = since(now, before, "at_us"), had_us = since(on, *then, "had_us");
  // A worker that has left takes with it what it has had.
  if (us <= 0 || had_us < 0 || had_us > us || since(on, *then, "times") < 0) return std::nullopt;
  return 100 * static_cast<double>(had_us) / static_cast<double>(us);
}

std::string percent(const std::optional<double>& value) {
  return value ? fmt::format("{:.1f}", *value) : "-";
}

}  // namespace

Json ask_machine(const std::string& socket) {
  return launch::ask_who_is_there(socket).value_or(Json());
}

std::vector<MachineXpu> machine_xpus(const Json& now, const Json& before) {
  std::vector<MachineXpu> xpus;
  for (const Json& coordinator : now.at("coordinators").elements()) {
    MachineXpu& xpu = xpus.emplace_back();
    xpu.xpu = text_of(coordinator.at("xpu"));
    xpu.slack_pct = coordinator.at("slack_pct").integer();
    for (const Json& app : now.at("apps").elements())
      for (const Json& on : app.at("xpus").elements()) {
        if (on.at("xpu").text() != coordinator.at("xpu").text()) continue;
        const std::int64_t lease = app.at("lease").integer().value_or(0);
        xpu.apps.push_back({.lease = lease,
                            .uid = app.at("uid").integer().value_or(-1),
                            .app = text_of(app.at("app")),
                            .regulated = app.at("regulated").boolean().value_or(false),
                            .admitted_pct = on.at("admitted_pct").number().value_or(0),
                            .had_us = on.at("had_us").integer().value_or(0),
                            .had_pct = had_pct(now, before, lease, on)});
      }
  }
  return xpus;
}

Json machine_json(Json now, const Json& before) {
  const Json said = now;
  Json* apps = now.find("apps");
  if (apps == nullptr) return now;
  for (Json& app : apps->elements())
    if (Json* xpus = app.find("xpus"))
      for (Json& on : xpus->elements())
        if (on.is_object())
          on["had_pct"] = had_pct(said, before, app.at("lease").integer().value_or(0), on);
  return now;
}

std::string machine_text(const Json& now, const Json& before) {
  const std::vector<MachineXpu> xpus = machine_xpus(now, before);
  if (xpus.empty()) return {};
  std::string out = row_of("together, % of its time", kNameColumns) +
                    fmt::format("{:>10}{:>10}{:>10}\n", "admitted", "had", "slack");
  for (const MachineXpu& xpu : xpus) {
    const std::string slack = xpu.slack_pct ? std::to_string(*xpu.slack_pct) : "-";
    double admitted = 0;
    std::optional<double> had = 0;
    for (const AppOnXpu& app : xpu.apps) {
      admitted += app.admitted_pct;
      had = had && app.had_pct ? std::optional(*had + *app.had_pct) : std::nullopt;
    }
    out += row_of(xpu.xpu, kNameColumns) +
           fmt::format("{:>10.1f}{:>10}{:>10}\n", admitted, percent(had), slack);
    for (const AppOnXpu& app : xpu.apps)
      out += row_of(fmt::format("  {} (uid {})", app.app, app.uid), kNameColumns) +
             fmt::format("{:>10.1f}{:>10}{}\n", app.admitted_pct, percent(app.had_pct),
                         app.regulated ? "  not trusted" : "");
  }
  if (const auto left = now.at("left_out").integer().value_or(0); left > 0)
    out += fmt::format("  {} more apps have joined\n", left);
  return out;
}

Status MachineRecord::follow(const Json& machine) {
  XAUTO_ASSIGN(auto records, launch::watch_machine(socket_));
  for (auto& [xpu, record] : records) {
    Followed& followed = xpus_[xpu];
    if (followed.record && followed.record.id() == record.id()) continue;
    // The XPU has had nobody in between.
    followed.missed += followed.reader.missed();
    followed.reader = {};
    followed.record = std::move(record);
  }
  for (const Json& app : machine.at("apps").elements())
    names_[static_cast<std::uint32_t>(app.at("lease").integer().value_or(0))] = app_of(app);
  return {};
}

void MachineRecord::look() {
  for (auto& [xpu, followed] : xpus_) {
    if (followed.times.size() < kMostRecorded)
      followed.reader.look(followed.record, followed.times);
  }
}

std::string MachineRecord::perfetto() const {
  story::PerfettoWriter out;
  const auto root = out.add_track(story::PerfettoWriter::kNoParent, "the machine",
                                  "who had which XPU, of all apps that have joined xauto-system");
  for (const auto& [xpu, followed] : xpus_) {
    const auto track = out.add_track(root, for_terminal(xpu, false));
    for (const coord::RecordedTime& time : one_at_a_time(followed.times)) {
      const auto name = names_.find(time.lease);
      out.begin(track, time.begin_ns,
                name == names_.end() ? fmt::format("lease {}", time.lease) : name->second);
      out.end(track, time.end_ns);
    }
    const std::uint64_t missed = followed.missed + followed.reader.missed();
    if (followed.times.empty() || (missed == 0 && followed.times.size() < kMostRecorded)) continue;
    out.mark_lossy();
    out.instant(root, followed.times.front().begin_ns,
                followed.times.size() < kMostRecorded
                    ? fmt::format("INCOMPLETE: {} jobs on {} were not seen", missed, xpu)
                    : fmt::format("INCOMPLETE: {} is shown as far as there is room", xpu));
  }
  return out.write(story::boottime_offset_ns());
}

std::vector<coord::RecordedTime> one_at_a_time(std::vector<coord::RecordedTime> times) {
  std::ranges::sort(times, {}, &coord::RecordedTime::begin_ns);
  std::set<std::pair<std::int64_t, std::size_t>> ends;  // of those that are open, with who
  std::set<std::size_t> open;                           // by begin
  std::vector<coord::RecordedTime> slices;
  std::int64_t now = 0;
  std::size_t had = times.size();  // whose slice the last one is
  const auto until = [&](std::int64_t then) {
    if (!open.empty() && then > now) {
      const std::size_t who = *open.rbegin();
      if (who != had || slices.back().end_ns != now)
        slices.push_back({times[who].lease, now, then});
      slices.back().end_ns = then;
      had = who;
    }
    now = std::max(now, then);
  };
  const auto close_until = [&](std::int64_t then) {
    while (!ends.empty() && ends.begin()->first <= then) {
      until(ends.begin()->first);
      open.erase(ends.begin()->second);
      ends.erase(ends.begin());
    }
  };
  for (std::size_t i = 0; i < times.size(); ++i) {
    close_until(times[i].begin_ns);
    until(times[i].begin_ns);
    open.insert(i);
    ends.emplace(times[i].end_ns, i);
  }
  close_until(INT64_MAX);
  return slices;
}

}  // namespace xauto::cli
