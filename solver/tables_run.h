// SPDX-License-Identifier: Apache-2.0
// What both searches for tables have in common: their limits, and how they use threads.
#pragma once

#include <algorithm>
#include <atomic>
#include <chrono>
#include <string>
#include <vector>

#include "model/loss.h"
#include "solver/choose_tables.h"
#include "solver/tables.h"
#include "solver/threads.h"
#include "solver/until.h"

namespace xauto::solver {

class TablesRun {
 public:
  explicit TablesRun(const TablesOptions& options, std::size_t scenarios)
      : options_(options), scenarios_(scenarios), began_(std::chrono::steady_clock::now()) {}

  [[nodiscard]] double elapsed() const {
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - began_).count();
  }
  [[nodiscard]] bool over() const {
    return (options_.stop != nullptr && options_.stop->load()) ||
           elapsed() >= options_.time_limit_s;
  }
  /// Nothing better is asked for.
  [[nodiscard]] double goal() const {
    return options_.tables > 0 ? std::max(1.0, options_.regret) : 1.0;
  }
  [[nodiscard]] int most() const {
    return options_.tables > 0 ? options_.tables : static_cast<int>(scenarios_);
  }
  /// Evaluations are counted per search: where they are limited, time is not.
  [[nodiscard]] Until until_after(double seconds) const {
    const auto deadline =
        options_.max_evaluations > 0
            ? TimePoint::max()
            : std::chrono::steady_clock::now() + std::chrono::duration_cast<TimePoint::duration>(
                                                     std::chrono::duration<double>(seconds));
    return {deadline, options_.stop};
  }
  void tell(std::size_t solved, double worst) const {
    if (options_.on_progress) options_.on_progress(elapsed(), static_cast<int>(solved), worst);
  }
  /// Of the half of the time in which scenarios are solved one by one, the share of number `s`.
  [[nodiscard]] double share_s(std::size_t s) const {
    constexpr double kPart = 0.5, kLeastS = 0.05;  // chosen
    return std::max(kLeastS, options_.time_limit_s * kPart - elapsed()) /
           static_cast<double>(scenarios_ - s);
  }
  /// `regret`: [candidate][scenario].
  [[nodiscard]] TableChoice choose(const std::vector<std::vector<double>>& regret) const {
    return choose_tables(regret, most(), options_.regret, options_.stop);
  }
  /// `xpu`: [candidate][XNode].
  [[nodiscard]] TableChoice fewer_instances(const std::vector<std::vector<double>>& regret,
                                            const std::vector<std::vector<int>>& xpu,
                                            const TableChoice& choice) const {
    return solver::fewer_instances(regret, xpu, choice, options_.regret);
  }
  /// kInfeasible: it is more than was asked for.
  [[nodiscard]] Status judge(double worst, const std::string& app) const {
    constexpr double kRounding = 1e-12;
    if (options_.regret < 1 || worst <= options_.regret + kRounding) return {};
    return fail(ErrorCode::kInfeasible,
                "the largest regret found is " + std::to_string(worst) + ", not " +
                    std::to_string(options_.regret),
                app, "more tables, or more time");
  }
  /// work(k) for all k below `tasks`, on as many threads as were asked for, or as there are.
  template <class Work>
  void on_threads(std::size_t tasks, Work work) const {
    std::atomic<std::size_t> next{0};
    const auto loop = [&] {
      for (std::size_t k; (k = next.fetch_add(1)) < tasks;) work(k);
    };
    Threads threads;
    for (int t = 1; t < options_.threads && threads.start(loop); ++t) {
    }
    loop();
    threads.join();
  }

 private:
  const TablesOptions& options_;
  const std::size_t scenarios_;
  const std::chrono::steady_clock::time_point began_;
};

/// "table 2 (lane off)".
[[nodiscard]] inline std::string name_of_table(std::size_t number, const Loss& loss,
                                               const AppSpec& app) {
  const std::string name = "table " + std::to_string(number);
  if (loss.none()) return name;
  const std::string words = words_of(loss, app);
  const bool fits = name.size() + words.size() + 3 <= kMaxNameBytes;
  return name +
         (fits ? " (" + words + ")" : " (loses " + std::to_string(loss_pct(loss, app)) + " %)");
}

}  // namespace xauto::solver
