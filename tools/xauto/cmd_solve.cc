// SPDX-License-Identifier: Apache-2.0
// xauto solve: app.json + platform.json -> policy.json, with a bound and, where possible, a proof.
// Progress goes to stderr: a redrawn line on a terminal, a line every two seconds elsewhere. Ctrl-C
// ends the search and writes the best policy so far.
#include <algorithm>
#include <atomic>
#include <csignal>
#include <cstdio>
#include <iostream>
#include <memory>

#include <unistd.h>

#include "model/json.h"
#include "solver/solve.h"

#include "xauto/command.h"

namespace xauto::cli {
namespace {

std::atomic<bool> interrupted{false};

extern "C" void on_interrupt(int) {
  interrupted.store(true);
  std::signal(SIGINT, SIG_DFL);  // a second Ctrl-C ends the program at once
}

struct Flags {
  std::string app, platform, out;
  solver::SolveOptions options;
};

std::string ms(std::int64_t us) {
  char text[32];
  std::snprintf(text, sizeof text, "%.2f ms", static_cast<double>(us) / 1000);
  return text;
}

/// One line of progress; on a terminal it overwrites itself.
class Line {
 public:
  void show(const solver::Progress& progress) {
    const bool due = terminal_ || progress.elapsed_s >= next_s_;
    if (!due || (terminal_ && progress.elapsed_s < 0.3)) return;
    next_s_ = progress.elapsed_s + 2;
    std::fprintf(stderr, "%s%6.1f s   best %s   bound %s   gap %.2f %%   %.0f k evaluations/s%s",
                 terminal_ ? "\r\033[K" : "", progress.elapsed_s, ms(progress.incumbent).c_str(),
                 ms(progress.bound).c_str(), progress.gap * 100, progress.evaluations_per_s / 1000,
                 terminal_ ? "" : "\n");
    drawn_ = terminal_;
  }
  void end() {
    if (drawn_) std::fputs("\r\033[K", stderr);
  }

 private:
  bool terminal_ = isatty(STDERR_FILENO) != 0, drawn_ = false;
  double next_s_ = 2;
};

void print_table(const AppSpec& app, const Platform& platform, const Policy& policy) {
  const auto latency = static_cast<double>(std::max<std::int64_t>(1, policy.latency_us));
  std::printf("%s on %s: %zu XNodes, method %s, %.2f s%s\n\n", app.name.c_str(),
              platform.name.c_str(), app.xnodes.size(), policy.method.c_str(),
              static_cast<double>(policy.solve_ms) / 1000,
              interrupted.load() ? " (interrupted: best so far)" : "");
  std::printf("  XPU        XNodes        load   of latency\n");
  for (std::size_t x = 0; x < platform.xpus.size(); ++x) {
    std::int64_t load = 0;
    int count = 0;
    for (std::size_t i = 0; i < policy.placements.size(); ++i) {
      if (policy.placements[i].xpu != static_cast<int>(x)) continue;
      load += app.xnodes[i].wcet_on(platform.xpus[x].type).value_or(0);
      ++count;
    }
    std::printf("  %-9s %7d %11s %10.1f %%\n", platform.xpus[x].id.c_str(), count, ms(load).c_str(),
                100 * static_cast<double>(load) / latency);
  }
  std::printf("\n  latency      %12s\n", ms(policy.latency_us).c_str());
  std::printf("  lower bound  %12s   %s\n", ms(policy.lower_bound_us).c_str(),
              policy.optimal ? "proven optimal" : "no schedule of any kind is shorter");
  std::printf("  gap          %10.2f %%\n",
              100 * static_cast<double>(policy.latency_us - policy.lower_bound_us) / latency);
  if (policy.worst_case_us)
    std::printf("  worst case   %12s   no execution within the WCETs is longer%s\n",
                ms(*policy.worst_case_us).c_str(),
                policy.order.empty() ? "" : ", kept by run-time order");
}

Result<int> solve(Flags& flags, const Options& options) {
  XAUTO_ASSIGN(const AppSpec app, load_app(flags.app));
  XAUTO_ASSIGN(const Platform platform, load_platform(flags.platform));
  Line line;
  flags.options.stop = &interrupted;
  flags.options.on_progress = [&](const solver::Progress& progress) { line.show(progress); };
  std::signal(SIGINT, on_interrupt);
  std::signal(SIGTERM, on_interrupt);
  const auto solved = solver::solve(app, platform, flags.options);
  line.end();
  if (!solved) return tl::unexpected<Error>(solved.error());
  const Policy& policy = *solved;
  if (!flags.out.empty()) XAUTO_TRY(write_file(flags.out, to_json(policy, app, platform)));
  if (options.json) {
    std::cout << to_json(policy, app, platform);
  } else {
    print_table(app, platform, policy);
    if (!flags.out.empty()) std::printf("\n  written to %s\n", flags.out.c_str());
  }
  return kDone;
}

}  // namespace

void add_solve(Commands& commands) {
  auto flags = std::make_shared<Flags>();
  CLI::App* verb = commands.add(
      "solve", "Choose an XPU and a priority for every XNode so that the app ends soonest.",
      "xauto solve --app app.json --platform small --time-limit-s 10 --out policy.json",
      [flags](const Options& options) {
        const auto status = solve(*flags, options);
        return status ? *status : report(status.error());
      });
  verb->add_option("--app", flags->app, "app.json")->required();
  verb->add_option("--platform", flags->platform, "small, large, or a platform.json")->required();
  verb->add_option("--out", flags->out, "where policy.json goes");
  verb->add_option("--method", flags->options.method, "how")
      ->check(CLI::IsMember({"auto", "search", "ilp", "heft", "local"}))
      ->capture_default_str();
  verb->add_option("--time-limit-s", flags->options.time_limit_s, "end after this long")
      ->check(CLI::NonNegativeNumber)
      ->capture_default_str();
  flags->options.threads = 2;
  verb->add_option("--threads", flags->options.threads, "solving threads")
      ->check(CLI::Range(1, 64))
      ->capture_default_str();
  verb->add_option("--seed", flags->options.seed, "of the search")->capture_default_str();
  verb->add_option(
          "--max-evaluations", flags->options.max_evaluations,
          "end after this many schedules; the answer then depends on seed and threads only")
      ->check(CLI::NonNegativeNumber);
}

}  // namespace xauto::cli
