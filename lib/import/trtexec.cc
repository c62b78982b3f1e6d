// SPDX-License-Identifier: Apache-2.0
#include "import/trtexec.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <set>

#include <fmt/format.h>

#include "base/index.h"
#include "base/quantile.h"
#include "model/components.h"
#include "model/json_value.h"
#include "model/periodic.h"

#include "import/questions.h"

namespace xauto::import {
namespace {

constexpr double kUsPerMs = 1000;
constexpr int kBisections = 60;

Result<Json> array_of(std::string_view text, const std::string& origin, const char* option) {
  const auto refuse = [&](const char* what) {
    return fail(ErrorCode::kInvalid, what, origin,
                std::string("`trtexec ") + option + "=FILE` writes one");
  };
  if (text.size() > kMaxTrtexecBytes) return refuse("is larger than 64 MiB");
  std::optional<Json> list = Json::parse(text);
  if (!list || !list->is_array()) return refuse("is no JSON array");
  return std::move(*list);
}

/// A time in ms as us, at least 1; none: it is no time.
std::optional<std::int64_t> us_of_ms(const Json& ms) {
  const auto value = ms.number();
  if (!value || !(*value >= 0) || *value * kUsPerMs > static_cast<double>(kMaxTimeUs))
    return std::nullopt;
  return std::max<std::int64_t>(1, static_cast<std::int64_t>(std::ceil(*value * kUsPerMs)));
}

/// How many stages of at most `most` us these layers need, in their order.
std::size_t stages_of(const std::vector<EngineLayer>& layers, double most) {
  std::size_t count = 1;
  double in_stage = 0;
  for (const EngineLayer& layer : layers) {
    if (in_stage > 0 && in_stage + layer.average_us > most) {
      ++count;
      in_stage = 0;
    }
    in_stage += layer.average_us;
  }
  return count;
}

/// [stage] its layers' time, and the first of them.
struct Stage {
  double us = 0;
  std::string first;
};

std::vector<Stage> cut(const std::vector<EngineLayer>& layers, std::size_t stages) {
  double low = 0, high = 0;
  for (const EngineLayer& layer : layers) {
    low = std::max(low, layer.average_us);
    high += layer.average_us;
  }
  for (int step = 0; step < kBisections && stages_of(layers, low) > stages; ++step) {
    const double middle = (low + high) / 2;
    (stages_of(layers, middle) > stages ? low : high) = middle;
  }
  const double most = stages_of(layers, low) > stages ? high : low;
  std::vector<Stage> made;
  for (const EngineLayer& layer : layers) {
    if (made.empty() || (made.back().us > 0 && made.back().us + layer.average_us > most))
      made.push_back({0, layer.name});
    made.back().us += layer.average_us;
  }
  return made;
}

std::int64_t part_of(std::int64_t us, double part) {
  return std::max<std::int64_t>(
      1, static_cast<std::int64_t>(std::ceil(static_cast<double>(us) * part)));
}

}  // namespace

Result<std::vector<std::int64_t>> parse_trtexec_times(std::string_view text,
                                                      const std::string& origin) {
  XAUTO_ASSIGN(const Json list, array_of(text, origin, "--exportTimes"));
  std::vector<std::int64_t> times;
  for (const Json& inference : list.elements()) {
    const auto us = us_of_ms(inference.at("latencyMs"));
    if (!us)
      return fail(ErrorCode::kInvalid, "has no \"latencyMs\" that is a time",
                  origin + ", inference " + std::to_string(times.size()),
                  "`trtexec --exportTimes=FILE` writes one");
    times.push_back(*us);
    if (times.size() > kMaxInferences)
      return fail(ErrorCode::kInvalid, "more than 2000000 inferences", origin, "cut it");
  }
  if (times.empty())
    return fail(ErrorCode::kInvalid, "has no inference", origin,
                "`trtexec --exportTimes=FILE` writes one");
  return times;
}

Result<std::vector<EngineLayer>> parse_trtexec_profile(std::string_view text,
                                                       const std::string& origin) {
  XAUTO_ASSIGN(const Json list, array_of(text, origin, "--exportProfile"));
  std::vector<EngineLayer> layers;
  double all = 0;
  for (const Json& layer : list.elements()) {
    if (!layer.has("name")) continue;  // {"count": ...}
    const auto name = layer.at("name").text();
    const auto ms = layer.at("averageMs").number();
    if (!name || !ms || !(*ms >= 0) || *ms * kUsPerMs > static_cast<double>(kMaxTimeUs) ||
        layers.size() >= kMaxLayers)
      return fail(ErrorCode::kInvalid,
                  layers.size() >= kMaxLayers ? "more than 100000 layers"
                                              : "has no \"name\" and \"averageMs\"",
                  origin + ", layer " + std::to_string(layers.size()),
                  "`trtexec --exportProfile=FILE` writes one");
    layers.push_back({*name, *ms * kUsPerMs});
    all += layers.back().average_us;
  }
  if (all <= 0)
    return fail(ErrorCode::kInvalid, "has no layer that takes time", origin,
                "`trtexec --exportProfile=FILE` writes one");
  return layers;
}

ImportedApp app_of_engines(const std::vector<EngineTimes>& engines, const std::string& name) {
  ImportedApp made;
  made.app.name = name;
  made.app.one_at_a_time = true;
  made.app.sources.push_back({"input", kNoRate});
  std::set<std::string> known;
  for (const EngineTimes& engine : engines)
    if (known.insert(engine.xnode).second)
      made.app.xnodes.push_back({engine.xnode, engine.xnode, {{engine.type, 1}}, {0}});
  complete_modules(made.app);
  made.todo.push_back({"/sources/0/rate_hz", "how often does 'input' come, in Hz?"});
  made.todo.push_back({"/deadline_us", "what is the deadline of each net, in us?"});
  made.todo.push_back(
      {"", "which net fires which other one? here they are side by side: see edges"});
  return made;
}

Status add_engines(const std::vector<EngineTimes>& engines, std::int64_t margin_pct,
                   ImportedApp& into, std::vector<std::string>& lines) {
  for (const EngineTimes& engine : engines) {
    const int x = into.app.find(engine.xnode);
    if (x < 0)
      return fail(ErrorCode::kNotFound, "the app has no XNode '" + engine.xnode + "'", "--trtexec",
                  "name one of app.json's");
    std::vector<std::int64_t> sorted = engine.times_us;
    std::ranges::sort(sorted);
    const std::int64_t median = quantile_of_sorted(sorted, 0.5);
    XNodeSpec& xnode = into.app.xnodes[at(x)];
    xnode.wcet_us[engine.type] = with_margin(sorted.back(), margin_pct);
    xnode.typical_us[engine.type] = median;
    const std::string at_place = "/xnodes/" + std::to_string(x) + "/wcet_us";
    std::erase_if(into.todo, [&](const Todo& todo) { return todo.at == at_place; });
    lines.push_back(fmt::format("{} on {}: p50 {}, p99 {}, max {} us of {} inferences",
                                engine.xnode, engine.type, median, quantile_of_sorted(sorted, 0.99),
                                sorted.back(), sorted.size()));
    into.todo.push_back(
        {"", todo_text("'" + engine.xnode + "' on " + engine.type +
                       ": timed alone; how long does it take beside other XPUs' work?")});
  }
  return {};
}

Status cut_at_layers(const std::string& xnode, const std::vector<EngineLayer>& layers,
                     std::size_t stages, ImportedApp& into, std::vector<std::string>& lines) {
  AppSpec& app = into.app;
  const int found = app.find(xnode);
  const bool joined = std::ranges::any_of(
      app.edges, [&](const auto& e) { return e.first == found || e.second == found; });
  if (found < 0 || joined || !app.samples.empty() || !app.chains.empty())
    return fail(found < 0 ? ErrorCode::kNotFound : ErrorCode::kInvalid,
                found < 0 ? "there is no net '" + xnode + "'"
                          : "'" + xnode + "' has edges, or the app has samples or chains",
                "--layers", "cut nets where the app is made of --trtexec alone");
  const std::vector<Stage> made = cut(layers, stages);
  double all = 0;
  for (const Stage& stage : made) all += stage.us;
  const XNodeSpec whole = app.xnodes[at(found)];
  std::string cuts;
  std::vector<XNodeSpec> parts;
  for (std::size_t s = 0; s < made.size(); ++s) {
    XNodeSpec part = whole;
    part.name = whole.name + "." + std::to_string(s + 1);
    if (s > 0) part.sources.clear();
    for (auto& [type, us] : part.wcet_us) us = part_of(us, made[s].us / all);
    for (auto& [type, us] : part.typical_us)
      us = std::min(part_of(us, made[s].us / all), part.wcet_us[type]);
    if (s > 0) cuts += (cuts.empty() ? "'" : ", '") + made[s].first + "'";
    parts.push_back(std::move(part));
  }
  const int more = static_cast<int>(parts.size()) - 1;
  for (auto& [u, v] : app.edges) {
    u += u > found ? more : 0;
    v += v > found ? more : 0;
  }
  for (int s = 0; s < more; ++s) app.edges.emplace_back(found + s, found + s + 1);
  app.xnodes.erase(app.xnodes.begin() + found);
  app.xnodes.insert(app.xnodes.begin() + found, parts.begin(), parts.end());
  lines.push_back(fmt::format("{}: {} stages; cut before {}", xnode, made.size(),
                              cuts.empty() ? "none" : cuts));
  into.todo.push_back({"", todo_text("does one tensor cross each cut of '" + xnode +
                                     "'? a stage's part of the time is that of its layers")});
  return {};
}

}  // namespace xauto::import
