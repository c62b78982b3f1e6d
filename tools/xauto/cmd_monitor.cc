// SPDX-License-Identifier: Apache-2.0
// xauto monitor: what goes on, for Prometheus and for ROS 2's /diagnostics. A process of its own that
// only reads, so it costs a run nothing, keeps none from ending, and ends without any harm.
//
//   runs' boards, coordinators ── looked at once per interval ──┬─► FILE.prom   (renamed into place)
//                                                               └─► /diagnostics
//
// It opens no port: node_exporter, or whatever collects the machine's metrics, serves the file.
#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <map>
#include <optional>
#include <utility>

#include <fmt/format.h>
#include <poll.h>
#include <unistd.h>

#include "base/clock.h"
#include "base/log.h"
#include "launch/system_protocol.h"

#include "xauto/command.h"
#include "xauto/diagnostics.h"
#include "xauto/diagnostics_topic.h"
#include "xauto/live.h"
#include "xauto/machine.h"
#include "xauto/metrics.h"
#include "xauto/run_app.h"

namespace xauto::cli {
namespace {

struct MonitorFlags {
  std::string run, file;
  int interval_ms = 1000, wait_s = 0;
  bool diagnostics = false;
  std::string system = launch::kSystemSocket;
};

/// Whole or not at all: who reads it never sees half of it.
Status replace_file(const std::string& path, const std::string& text) {
  const std::filesystem::path whole(path);
  const std::string fresh =
      (whole.parent_path() / fmt::format(".{}.{}", whole.filename().string(), getpid())).string();
  std::ofstream file(fresh, std::ios::trunc | std::ios::binary);
  file << text << std::flush;
  file.close();
  if (file && std::rename(fresh.c_str(), path.c_str()) == 0) return {};
  Error error{ErrorCode::kIo, std::string("cannot be written: ") + strerror(errno),
              "--metrics-file " + path, "name a file in a folder that you may write"};
  (void)std::remove(fresh.c_str());
  return tl::unexpected<Error>(std::move(error));
}

/// A run that is watched, and what was last said of it.
struct Seen {
  Watched run;
  RunLook look;
  std::vector<Diagnostic> said;
};

/// Until then, or until it is told to end.
void wait_until(std::int64_t until_ns, const std::atomic<bool>& stop) {
  for (std::int64_t now = now_ns(); now < until_ns && !stop.load(); now = now_ns())
    poll(nullptr, 0,
         static_cast<int>(std::min<std::int64_t>(100, (until_ns - now) / 1'000'000 + 1)));
}

class Monitor {
 public:
  explicit Monitor(const MonitorFlags& flags) : flags_(flags) {}

  Status open() {
    if (flags_.diagnostics) {
      XAUTO_ASSIGN(topic_, DiagnosticsTopic::open());
    }
    return {};
  }

  /// Looks once, and tells everybody. Returns whether a run goes on.
  Result<bool> look() {
    const std::vector<std::string> going = running();
    const auto goes_on = [&](const std::string& run) {
      return std::find(going.begin(), going.end(), run) != going.end();
    };
    std::vector<Diagnostic> all;
    const auto tell = [&](const std::vector<Diagnostic>& list) {
      all.insert(all.end(), list.begin(), list.end());
    };
    for (auto seen = seen_.begin(); seen != seen_.end();) {
      if (goes_on(seen->first)) {
        ++seen;
        continue;
      }
      tell(stale(std::move(seen->second.said), "the run has ended"));
      seen = seen_.erase(seen);
    }
    std::vector<std::string> fresh;
    for (const std::string& run : going)
      if (!seen_.contains(run) && (flags_.run.empty() || flags_.run == run)) fresh.push_back(run);
    for (Watched& watched : introduced(fresh)) {  // others begin or end, or are somebody else's
      const std::string run = watched.run;
      seen_.try_emplace(run, Seen{std::move(watched), {}, {}});
    }
    std::map<std::string, Coordinated> coordinated = ask_coordinators(flags_.run);
    std::vector<RunLook> looks;
    for (auto& [run, seen] : seen_) {
      RunLook now{run,
                  seen.run.app,
                  seen.run.platform,
                  seen.run.scheduling,
                  counts_of(*seen.run.board),
                  std::move(coordinated[run].xpus),
                  seen.run.host};
      seen.said = diagnostics_of(now, seen.said.empty() ? nullptr : &seen.look);
      tell(seen.said);
      looks.push_back(now);
      seen.look = std::move(now);
    }
    said_ = all;
    metrics_ = metrics_text(looks, machine_xpus(ask_machine(flags_.system), {}));
    if (topic_ && !all.empty()) topic_->publish(all);
    if (flags_.file.empty()) return !seen_.empty();
    // A disk that is full later on is no reason to end the rest; who reads the file sees its age.
    Status written = replace_file(flags_.file, metrics_);
    if (!written && std::exchange(began_, true)) {
      if (!std::exchange(failing_, true)) log::warn("{}", written.error().to_string());
      return !seen_.empty();
    }
    began_ = true;
    failing_ = false;
    XAUTO_TRY(std::move(written));
    return !seen_.empty();
  }

  /// What nobody brings up to date any more must not look as if it were.
  void close() {
    if (!flags_.file.empty()) (void)std::remove(flags_.file.c_str());
    if (!topic_) return;
    std::vector<Diagnostic> all;
    for (auto& [run, seen] : seen_)
      for (Diagnostic& d : stale(std::move(seen.said), "xauto monitor has ended"))
        all.push_back(std::move(d));
    if (!all.empty()) topic_->publish(all);
    for (const std::string& note : topic_->close()) log::warn("{}", note);
  }

  [[nodiscard]] const std::string& metrics() const { return metrics_; }
  [[nodiscard]] const std::vector<Diagnostic>& said() const { return said_; }

 private:
  const MonitorFlags& flags_;
  std::optional<DiagnosticsTopic> topic_;
  std::map<std::string, Seen> seen_;
  std::string metrics_;
  std::vector<Diagnostic> said_;
  bool began_ = false, failing_ = false;  ///< to write the file
};

std::string statuses_json(const std::vector<Diagnostic>& statuses) {
  Json list = Json::array();
  for (const Diagnostic& d : statuses) {
    Json values = Json::object();
    for (const auto& [key, value] : d.values) values[key.c_str()] = value;
    list.push_back({{"level", to_string(d.level)},
                    {"name", d.name},
                    {"message", d.message},
                    {"hardware_id", d.hardware_id},
                    {"values", std::move(values)}});
  }
  return Json{{"status", std::move(list)}}.dump(2) + "\n";
}

Result<int> monitor(const MonitorFlags& flags, const Options& options) {
  const StopOnSignal stop;
  const bool once = flags.file.empty() && !flags.diagnostics;
  // One run by name, or one look: it is waited for. A monitor of all runs waits for any, for ever.
  if ((once && running().empty()) || !flags.run.empty()) {
    XAUTO_TRY(watch(flags.run, flags.wait_s, *stop.flag()));
  }
  Monitor monitor(flags);
  XAUTO_TRY(monitor.open());
  const std::int64_t interval_ns = std::int64_t{flags.interval_ms} * 1'000'000;
  if (once) {
    XAUTO_TRY(monitor.look());
    wait_until(now_ns() + interval_ns, *stop.flag());
    XAUTO_TRY(monitor.look());  // rates are about the time in between
    std::cout << (options.json ? statuses_json(monitor.said()) : monitor.metrics());
    return kDone;
  }
  std::int64_t due_ns = now_ns();
  Status status;
  while (!stop.flag()->load()) {
    const Result<bool> any = monitor.look();
    if (!any) {
      status = tl::unexpected<Error>(any.error());
      break;
    }
    if (!*any && !flags.run.empty()) break;  // the run that it is for has ended
    due_ns = std::max(due_ns + interval_ns, now_ns());
    wait_until(due_ns, *stop.flag());
  }
  monitor.close();
  if (!status) return tl::unexpected<Error>(std::move(status).error());
  return kDone;
}

}  // namespace

void add_monitor(Commands& commands) {
  auto flags = std::make_shared<MonitorFlags>();
  Verb verb = commands.add(
      "monitor",
      "Export runs that go on, for Prometheus and for ROS 2's /diagnostics; without an output: the "
      "metrics once.",
      "xauto monitor\n"
      "  xauto monitor --diagnostics --metrics-file /var/lib/prometheus/node-exporter/xauto.prom",
      [flags](const Options& options) { return monitor(*flags, options); });
  verb.option("--metrics-file", flags->file,
              "keep the metrics in this file (FILE.prom), for node_exporter's textfile collector");
  verb.flag("--diagnostics", flags->diagnostics,
            "publish diagnostic_msgs/msg/DiagnosticArray on /diagnostics, over Cyclone DDS");
  verb.option("--run", flags->run, "this run alone, to its end; default: all, also later ones");
  verb.option("--system", flags->system, "the socket of xauto-system, which says who has joined")
      .shown();
  verb.duration("--interval", flags->interval_ms, Unit::kMilliseconds, 50, 60'000,
                "between two looks");
  verb.duration("--wait", flags->wait_s, Unit::kSeconds, 0, kYearS,
                "how long to wait for a run to begin");
}

}  // namespace xauto::cli
