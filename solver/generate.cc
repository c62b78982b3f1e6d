// SPDX-License-Identifier: Apache-2.0
#include "solver/generate.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "base/index.h"
#include "model/periodic.h"
#include "solver/random.h"

namespace xauto::solver {
namespace {

constexpr int kAttempts = 200'000;

std::string numbered(const char* prefix, int i, int digits) {
  std::string number = std::to_string(i);
  std::string name = prefix;
  name.append(at(std::max(0, digits - static_cast<int>(number.size()))), '0');
  return name += number;
}

std::string text(double value) {
  std::string s = std::to_string(value);
  while (s.back() == '0') s.pop_back();
  if (s.back() == '.') s.pop_back();
  return s;
}

/// A part of the graph while it grows: what hangs on its front and its back.
struct Subgraph {
  std::vector<int> entries, exits, all;
};

class Shape {
 public:
  Shape(const GenerateOptions& options, int max_depth, std::uint64_t seed)
      : o_(options), max_depth_(max_depth), random_(seed) {}

  /// False: more XNodes than asked for.
  bool grow() {
    expand(0);
    std::sort(edges_.begin(), edges_.end());
    return count_ == o_.nodes;
  }
  [[nodiscard]] const std::vector<std::pair<int, int>>& edges() const { return edges_; }

 private:
  Subgraph expand(int depth) {
    if (count_ > o_.nodes) return {};  // rejected already
    if (depth >= max_depth_ || (depth > 0 && random_.unit() <= o_.terminal)) return single();
    Subgraph whole;
    Subgraph fork, join;
    if (o_.fork_join) fork = single();
    const auto choices =
        static_cast<std::uint64_t>(o_.branch_max) - static_cast<std::uint64_t>(o_.branch_min) + 1;
    const int branches = o_.branch_min + static_cast<int>(random_.below(choices));
    std::vector<Subgraph> parts;
    for (int b = 0; b < branches; ++b) parts.push_back(expand(depth + 1));
    if (o_.fork_join) join = single();
    if (count_ > o_.nodes) return {};
    connect_siblings(parts);
    for (const Subgraph& part : parts) {
      if (o_.fork_join) {
        connect(fork.exits, part.entries);
        connect(part.exits, join.entries);
      } else {
        whole.entries.insert(whole.entries.end(), part.entries.begin(), part.entries.end());
        whole.exits.insert(whole.exits.end(), part.exits.begin(), part.exits.end());
      }
      whole.all.insert(whole.all.end(), part.all.begin(), part.all.end());
    }
    if (o_.fork_join) {
      whole.entries = fork.entries;
      whole.exits = join.exits;
      whole.all.push_back(fork.all.front());
      whole.all.push_back(join.all.front());
    }
    return whole;
  }

  Subgraph single() {
    const int i = count_++;
    return {{i}, {i}, {i}};
  }

  void connect(const std::vector<int>& from, const std::vector<int>& to) {
    for (const int u : from)
      for (const int v : to) edges_.emplace_back(u, v);
  }

  void connect_siblings(const std::vector<Subgraph>& parts) {
    std::vector<std::size_t> order(parts.size());
    std::iota(order.begin(), order.end(), std::size_t{0});
    if (o_.sibling_direction == "shuffled")
      for (std::size_t i = order.size() - 1; i > 0; --i)
        std::swap(order[i], order[random_.below(i + 1)]);
    for (std::size_t a = 0; a < order.size(); ++a)
      for (std::size_t b = a + 1; b < order.size(); ++b) {
        if (random_.unit() > o_.sibling_edge) continue;
        const Subgraph &from = parts[order[a]], &to = parts[order[b]];
        if (o_.sibling_direction == "node")
          edges_.emplace_back(from.all[random_.below(from.all.size())],
                              to.all[random_.below(to.all.size())]);
        else
          connect(from.exits, to.entries);
      }
  }

  const GenerateOptions& o_;
  const int max_depth_;
  Random random_;
  int count_ = 0;
  std::vector<std::pair<int, int>> edges_;  ///< each once: one per pair of parts
};

/// Least nesting at which twice the wanted size is the expected size, and at least the
/// paper-like 4.
int depth_for(const GenerateOptions& o) {
  const double branches = (o.branch_min + o.branch_max) / 2.0;
  const double own = o.fork_join ? 2 : 0;
  double expected = 1;  // of a part that may still nest `depth` times
  int depth = 0;
  while (depth < 4 || (expected < 2.0 * o.nodes && depth < 40)) {
    const double inside = depth == 0 ? 1 : o.terminal + (1 - o.terminal) * expected;
    expected = own + branches * inside;
    ++depth;
  }
  return depth;
}

void draw_times(const GenerateOptions& o, Random& random, const std::vector<int>& name_order,
                AppSpec& app) {
  const std::size_t n = app.xnodes.size();
  std::vector<std::int64_t> cpu(n);
  for (const int i : name_order)
    cpu[at(i)] = o.cpu_min_us + static_cast<std::int64_t>(random.below(
                                    static_cast<std::uint64_t>(o.cpu_max_us - o.cpu_min_us + 1)));
  std::vector<int> by_time = name_order;
  std::stable_sort(by_time.begin(), by_time.end(),
                   [&](int a, int b) { return cpu[at(a)] > cpu[at(b)]; });
  const auto heavy = static_cast<std::size_t>(std::llround(o.heavy_share * static_cast<double>(n)));
  const auto between = [&](double low, double high) { return low + (high - low) * random.unit(); };
  const auto faster = [](std::int64_t us, double speedup) {
    return std::max<std::int64_t>(1, std::llround(static_cast<double>(us) / speedup));
  };
  for (std::size_t k = 0; k < n; ++k) {
    XNodeSpec& xnode = app.xnodes[at(by_time[k])];
    const std::int64_t us = cpu[at(by_time[k])];
    // Drawn whether needed or not, so that one option does not shift the numbers of another.
    const double gpu = random.unit(), dla = random.unit(), on_cpu = random.unit();
    const double gpu_speedup = between(o.gpu_speedup_min, o.gpu_speedup_max);
    const double dla_speedup = between(o.dla_speedup_min, o.dla_speedup_max);
    if (gpu <= (k < heavy ? o.heavy_gpu : o.light_gpu))
      xnode.wcet_us["gpu"] = faster(us, gpu_speedup);
    if (dla <= (k < heavy ? o.heavy_dla : o.light_dla))
      xnode.wcet_us["dla"] = faster(us, dla_speedup);
    if (xnode.wcet_us.empty() || on_cpu <= o.cpu_share) xnode.wcet_us["cpu"] = us;
  }
}

Status check(const GenerateOptions& o) {
  const auto bad = [](const char* option, const std::string& value, const char* range) {
    return fail(ErrorCode::kInvalid, value + " is not " + range, option);
  };
  if (o.nodes < 1 || at(o.nodes) > kMaxXNodes)
    return bad("--nodes", std::to_string(o.nodes), "from 1 to 20000");
  if (o.max_depth < 0 || o.max_depth > 40)
    return bad("--max-depth", std::to_string(o.max_depth), "from 0 to 40");
  if (o.branch_min < 1 || o.branch_max < o.branch_min || o.branch_max > 1000)
    return bad("--branches", std::to_string(o.branch_min) + ".." + std::to_string(o.branch_max),
               "a range within 1..1000");
  if (o.cpu_min_us < 1 || o.cpu_max_us < o.cpu_min_us || o.cpu_max_us > 1'000'000'000)
    return bad("--cpu-time",
               std::to_string(o.cpu_min_us) + ".." + std::to_string(o.cpu_max_us) + " us",
               "a range within 1 us and 1000 s");
  for (const auto& [name, p] : {std::pair{"--terminal", o.terminal},
                                {"--sibling-edge", o.sibling_edge},
                                {"--heavy-share", o.heavy_share},
                                {"--heavy-gpu", o.heavy_gpu},
                                {"--heavy-dla", o.heavy_dla},
                                {"--light-gpu", o.light_gpu},
                                {"--light-dla", o.light_dla},
                                {"--cpu-share", o.cpu_share}})
    if (!(p >= 0 && p <= 1)) return bad(name, text(p), "a probability");
  for (const auto& [name, low, high] :
       {std::tuple{"--gpu-speedup", o.gpu_speedup_min, o.gpu_speedup_max},
        {"--dla-speedup", o.dla_speedup_min, o.dla_speedup_max}})
    if (!(low > 0 && high >= low && high <= 1e6))
      return bad(name, text(low) + ".." + text(high), "a range above 0");
  if (o.sibling_direction != "forward" && o.sibling_direction != "shuffled" &&
      o.sibling_direction != "node")
    return bad("--sibling-direction", "'" + o.sibling_direction + "'", "forward, shuffled or node");
  return {};
}

}  // namespace

std::vector<std::pair<std::string, std::string>> GenerateOptions::describe() const {
  const auto range = [](const std::string& low, const std::string& high) {
    return low + ".." + high;
  };
  return {{"nodes", std::to_string(nodes)},
          {"seed", std::to_string(seed)},
          {"terminal", text(terminal)},
          {"max_depth", std::to_string(max_depth > 0 ? max_depth : depth_for(*this))},
          {"branches", range(std::to_string(branch_min), std::to_string(branch_max))},
          {"fork_join", fork_join ? "counted" : "none"},
          {"sibling_edge", text(sibling_edge)},
          {"sibling_direction", sibling_direction},
          {"size", "exact, by rejection"},
          {"cpu_us", range(std::to_string(cpu_min_us), std::to_string(cpu_max_us))},
          {"heavy_share", text(heavy_share)},
          {"heavy_gpu", text(heavy_gpu)},
          {"heavy_dla", text(heavy_dla)},
          {"light_gpu", text(light_gpu)},
          {"light_dla", text(light_dla)},
          {"gpu_speedup", range(text(gpu_speedup_min), text(gpu_speedup_max))},
          {"dla_speedup", range(text(dla_speedup_min), text(dla_speedup_max))},
          {"cpu_share", text(cpu_share)}};
}

Result<AppSpec> generate(const GenerateOptions& options) {
  XAUTO_TRY(check(options));
  const int depth = options.max_depth > 0 ? options.max_depth : depth_for(options);
  Random seeds(options.seed);
  for (int attempt = 0; attempt < kAttempts; ++attempt) {
    Shape shape(options, depth, seeds.next());
    if (options.nodes > 1 && !shape.grow()) continue;
    AppSpec app;
    app.name = "synthetic-" + std::to_string(options.nodes) + "-" + std::to_string(options.seed);
    const int digits = static_cast<int>(std::to_string(options.nodes - 1).size());
    std::vector<int> indices(at(options.nodes));
    std::iota(indices.begin(), indices.end(), 0);
    for (const int i : indices)
      app.xnodes.push_back({numbered("x", i, digits), numbered("m", i, digits), {}});
    if (options.nodes > 1) app.edges = shape.edges();
    Random times(seeds.next());
    draw_times(options, times, indices, app);
    app.one_at_a_time = true;
    app.sources = {{"release", kNoRate}};
    const auto before = app.predecessors();
    for (std::size_t i = 0; i < app.xnodes.size(); ++i)
      if (before[i].empty()) app.xnodes[i].sources = {0};
    complete_modules(app);
    complete_chains(app);
    return app;
  }
  return fail(ErrorCode::kInfeasible,
              "no graph of " + std::to_string(options.nodes) + " XNodes in " +
                  std::to_string(kAttempts) + " attempts",
              "--nodes",
              "allow more depth (--max-depth) or another number of branches (--branches)");
}

}  // namespace xauto::solver
