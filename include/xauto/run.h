// SPDX-License-Identifier: Apache-2.0
// A run inside a process of somebody else's (a ROS 2 node, a test): what is asked of App::run, and
// what it answers. Programs that `xauto run` starts need none of it.
#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

namespace xauto {

/// What App::run is asked; what is not said is as `xauto run` has it. A value. Setters return the
/// object, so that they can be chained; App::run checks what they were given.
class RunOptions {
 public:
  RunOptions();
  ~RunOptions();
  /// A copy of its own.
  RunOptions(const RunOptions& other);
  /// As the constructor.
  RunOptions& operator=(const RunOptions& other);

  /// app.json: a path, or the JSON text itself (it begins with "{"). Needed.
  RunOptions& app(std::string path_or_text);
  /// policy.json, or tables.json: each release gets one of its policies (docs/modes.md). Likewise.
  /// Needed unless the scheduling is "ros2".
  RunOptions& policy(std::string path_or_text);
  /// A built-in one ("small", "orin", ...: docs/formats.md), a platform.json, or its text. Default: "small".
  RunOptions& platform(std::string name_or_path_or_text);
  /// deployment.json, likewise. Its modules must stay in one process.
  RunOptions& deployment(std::string path_or_text);
  /// XPUs or types that are emulated, the others are real: {"gpu", "dla0"}; {}: all are emulated.
  /// Default: what this machine lacks, and what the app only has stand-ins for.
  RunOptions& emulate(std::vector<std::string> names = {});
  /// Refuses to emulate.
  RunOptions& real();
  /// "xauto" (default), "timeshare" or "ros2".
  RunOptions& scheduling(std::string name);
  /// Threads of CPU XNodes on real cores: "fifo" (default) or "other".
  RunOptions& cpu_sched(std::string name);
  /// Releases of the slowest source; 0: until App::stop or the input's end. Default: 200.
  RunOptions& activations(std::uint64_t count);
  /// Release for so long instead; 0: activations count.
  RunOptions& duration(std::chrono::microseconds length);
  /// Instead of the periods of polled sources; 0: theirs.
  RunOptions& period(std::chrono::microseconds period);
  /// The next release comes when the last one has drained.
  RunOptions& lockstep(bool on = true);
  /// A recorded input to replay instead of the sources' messages.
  RunOptions& input(std::string path);
  /// Record the sources' messages here.
  RunOptions& record(std::string path);
  /// "newest" (default), "queue:N" or "skip": what a module that is not free does with further
  /// messages. Of all modules.
  RunOptions& overload(std::string policy);
  /// The folder with xauto-coordinator and xauto-emud. Default: XAUTO_PROGRAMS of the environment,
  /// else where they are installed beside this library.
  RunOptions& programs(std::string folder);

 private:
  friend class App;
  struct Data;
  std::unique_ptr<Data> data_;
};

/// What became of a run. A value; cheap to copy. Times are from a release at its sensor to the end
/// of the last module that it reaches; 0 where there is no result. Threads: any.
class RunReport {
 public:
  /// Shares what it reports, which nobody changes.
  RunReport(const RunReport&);
  /// As the constructor.
  RunReport& operator=(const RunReport&);
  ~RunReport();

  /// All that was released has a result, nobody was lost: `xauto run` would end with status 0.
  [[nodiscard]] bool good() const;
  /// Every release was accounted for before the end, as a result or as lost.
  [[nodiscard]] bool complete() const;
  /// Why not, or what was done differently than asked; for people, may have several lines.
  [[nodiscard]] std::string note() const;
  /// Releases of the sensors; with sources of several periods 0, see the modules.
  [[nodiscard]] std::uint64_t releases() const;
  /// ... without a result.
  [[nodiscard]] std::uint64_t lost() const;
  /// ... later than the deadline of app.json, or lost.
  [[nodiscard]] std::uint64_t deadline_misses() const;
  /// Nearest rank.
  [[nodiscard]] std::chrono::microseconds p50() const;
  /// As p50().
  [[nodiscard]] std::chrono::microseconds p99() const;
  /// The longest.
  [[nodiscard]] std::chrono::microseconds max() const;

  /// Names, in the order in which they were added.
  [[nodiscard]] std::vector<std::string> modules() const;
  /// Activations that came to their end. Of a module that is not there 0, here and below.
  [[nodiscard]] std::uint64_t results(const std::string& module) const;
  /// Activations that failed (exec threw or returned an error), or had no input in time.
  [[nodiscard]] std::uint64_t lost(const std::string& module) const;
  /// Of a module whose results no other module reads; else 0.
  [[nodiscard]] std::chrono::microseconds p50(const std::string& module) const;
  /// As p50().
  [[nodiscard]] std::chrono::microseconds p99(const std::string& module) const;
  /// The longest.
  [[nodiscard]] std::chrono::microseconds max(const std::string& module) const;

  /// All of the above, and the chains, as one JSON object; docs/api.md has its members.
  [[nodiscard]] std::string json() const;

 private:
  friend class App;
  struct Data;
  explicit RunReport(std::shared_ptr<const Data> data);
  std::shared_ptr<const Data> data_;
};

}  // namespace xauto
