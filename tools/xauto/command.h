// SPDX-License-Identifier: Apache-2.0
// The frame of the `xauto` command line: each verb lives in cmd_<verb>.cc and registers itself
// here. Results go to stdout (a table, or one JSON object with --json); progress and logs go to
// stderr.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <string>
#include <vector>

#include <unistd.h>

#include <xauto/result.h>

#include "base/terminal.h"
#include "cli/cli.h"

namespace xauto::cli {

/// Exit statuses of every verb (shared/formats.md).
enum Exit : int { kDone = 0, kAnswerIsNo = 1, kBadInput = 2 };

/// kInfeasible -> 1; bad input, missing files -> 2; everything else (I/O, peers) -> 1.
[[nodiscard]] int exit_status(const Error& error);

/// "12.34 ms", and below a millisecond "0.004 ms".
[[nodiscard]] std::string ms(std::int64_t us);

/// The last line of what says that all numbers are true, where not all that was asked for is kept: why
/// the exit status is 1. Empty: nothing is missed.
[[nodiscard]] std::string words_of_missed(const std::vector<std::string>& missed);

/// The last line about a file of which so many statements are false.
[[nodiscard]] std::string words_of_lies(const std::string& path, std::size_t lies);

struct Options {
  bool json = false;    ///< --json, accepted by every verb
  bool strict = false;  ///< --strict, accepted by every verb that reads files of ours
};

/// A verb's body: runs after parsing, returns the exit status. Its error is reported by `run`.
using Body = std::function<Result<int>(const Options&)>;

class Commands {
 public:
  explicit Commands(Program& program) : program_(program) {}
  /// Declares a verb with its one-line description and the example shown under --help.
  Verb add(const std::string& verb, const std::string& description, const std::string& example,
           Body body);
  int run(int argc, char** argv);

 private:
  Program& program_;
  Options options_;
  std::map<std::string, Body> bodies_;  ///< [verb]
};

// One per cmd_*.cc.
void add_check(Commands&);
void add_compare(Commands&);
void add_doctor(Commands&);
void add_explain(Commands&);
void add_generate(Commands&);
void add_graph(Commands&);
void add_import(Commands&);
void add_monitor(Commands&);
void add_param(Commands&);
void add_prio(Commands&);
void add_profile(Commands&);
void add_recording(Commands&);
void add_report(Commands&);
void add_run(Commands&);
void add_simulate(Commands&);
void add_solve(Commands&);
void add_split(Commands&);
void add_top(Commands&);
void add_whatif(Commands&);

/// What a search tells on stderr: one line that overwrites itself on a terminal, from 0.3 s on;
/// elsewhere a line every two seconds. Threads: one caller at a time.
class SearchLine {
 public:
  [[nodiscard]] bool due(double elapsed_s) const;
  void show(double elapsed_s, const std::string& text);
  void end();

 private:
  bool terminal_ = can_draw(STDERR_FILENO), drawn_ = false;
  double next_s_ = 2;
};

/// A progress bar on stderr: drawn only on a terminal or, off a terminal, as a line every few
/// seconds. Appears after two seconds of work. Logs take its place, it is redrawn below (base/log).
/// Threads: one caller.
class Progress {
 public:
  Progress(std::string label, double total);
  ~Progress();
  /// `done` of `total`; below 0: nobody knows, there is no bar.
  void update(double done, const std::string& note = {});
  void finish();

 private:
  void draw(bool last);
  std::string label_, note_;
  double total_, done_ = 0;
  std::int64_t started_ms_, drawn_ms_ = 0;
  bool terminal_, shown_ = false, finished_ = false;
};

}  // namespace xauto::cli
