// SPDX-License-Identifier: Apache-2.0
// What is outside of every scenario: a job of an XNode, what a file of the machine says. Which of it is
// said, and how often each was. Pure: time comes from outside.
//
// Each is said when it comes, for the first time always: there are no more than XNodes and files. What
// comes anew after it was over is said again, as far as kAgain lines in kAgainNs go, so that a clock
// that flutters fills no log. What is not said is counted.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <string>
#include <utility>
#include <vector>

namespace xauto::runtime {

/// Threads: one at a time.
class OutsideLog {
 public:
  static constexpr int kAgain = 5;
  static constexpr std::int64_t kAgainNs = 60'000'000'000;

  enum class Kind : std::uint8_t { kJob, kFile };
  struct What {
    Kind kind = Kind::kJob;
    std::string name;  ///< of the XNode, the file
    std::function<std::string()> words;
  };
  struct News {
    std::vector<std::string> say;
    std::uint64_t jobs = 0, files = 0;  ///< that have come
  };
  /// `outside`: all that is, at `now_ns`. What is not among it any more is over.
  [[nodiscard]] News look(std::int64_t now_ns, const std::vector<What>& outside);
  /// A line each, of what came of that kind: what was said of it first, and how often it came.
  [[nodiscard]] std::vector<std::string> all(Kind kind) const;

 private:
  struct Entry {
    bool is = false;
    std::uint64_t times = 0;
    std::string first;
  };
  std::map<std::pair<Kind, std::string>, Entry> entries_;
  std::int64_t again_since_ns_ = 0;
  int again_ = 0;  ///< since then
};

}  // namespace xauto::runtime
