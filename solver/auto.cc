// SPDX-License-Identifier: Apache-2.0
// See auto.h.
#include "solver/auto.h"

#include <algorithm>
#include <condition_variable>
#include <mutex>
#include <thread>

#include "solver/bounds.h"

namespace xauto::solver {

AutoResult solve_in_parallel(const Problem& problem, const SolveOptions& options,
                             const std::vector<Solution>& starts, bool with_proof) {
  (void)with_proof;
  const auto began = std::chrono::steady_clock::now();
  const int threads = std::clamp(options.threads, 1, 64);
  std::atomic<Time> bound{quick_bound(problem)};
  std::atomic<std::int64_t> evaluations{0};
  std::mutex mutex;
  std::condition_variable changed;
  int running = threads;
  Time incumbent = starts.front().makespan;

  Limits limits;
  limits.deadline = began + std::chrono::duration_cast<std::chrono::steady_clock::duration>(
                                std::chrono::duration<double>(std::max(0.0, options.time_limit_s)));
  limits.stop = options.stop;
  limits.target = &bound;
  if (options.max_evaluations > 0)
    limits.max_evaluations = std::max<std::int64_t>(1, options.max_evaluations / threads);

  SearchCallbacks callbacks;
  callbacks.on_better = [&](const Solution& solution) {
    const std::lock_guard lock(mutex);
    if (solution.makespan < incumbent) incumbent = solution.makespan;
  };
  callbacks.on_evaluations = [&](std::int64_t count) {
    evaluations.fetch_add(count, std::memory_order_relaxed);
  };

  std::vector<Solution> answers(static_cast<std::size_t>(threads));
  std::vector<std::thread> workers;
  for (int t = 0; t < threads; ++t) {
    workers.emplace_back([&, t] {
      const auto k = static_cast<std::size_t>(t);
      Solution answer =
          anneal(problem, starts[k % starts.size()],
                 options.seed * 1000003 + static_cast<std::uint64_t>(t), limits, callbacks);
      const std::lock_guard lock(mutex);
      answers[k] = std::move(answer);
      --running;
      changed.notify_all();
    });
  }
  {
    std::unique_lock lock(mutex);
    while (running > 0) {
      changed.wait_for(lock, std::chrono::milliseconds(100));
      if (!options.on_progress) continue;
      Progress progress;
      progress.elapsed_s =
          std::chrono::duration<double>(std::chrono::steady_clock::now() - began).count();
      progress.incumbent = incumbent;
      progress.bound = bound.load();
      progress.gap = incumbent > 0 ? static_cast<double>(incumbent - progress.bound) /
                                         static_cast<double>(incumbent)
                                   : 0;
      progress.evaluations_per_s =
          static_cast<double>(evaluations.load()) / std::max(1e-9, progress.elapsed_s);
      lock.unlock();
      options.on_progress(progress);
      lock.lock();
    }
  }
  for (std::thread& worker : workers) worker.join();

  AutoResult result;
  result.best = starts.front();
  for (Solution& answer : answers)
    if (answer.makespan < result.best.makespan) result.best = std::move(answer);
  result.bound = std::min(bound.load(), result.best.makespan);
  result.evaluations = evaluations.load();
  return result;
}

}  // namespace xauto::solver
