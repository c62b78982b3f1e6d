// SPDX-License-Identifier: Apache-2.0
#include "model/profile.h"

#include <algorithm>
#include <cstdlib>
#include <set>

#include "base/quantile.h"
#include "model/components.h"
#include "model/contention.h"
#include "model/periodic.h"
#include "model/refusal.h"

namespace xauto {

Samples summarise(const std::vector<std::int64_t>& samples, std::int64_t settled_after) {
  if (samples.empty()) return {};
  std::vector<std::int64_t> sorted = samples;
  std::sort(sorted.begin(), sorted.end());
  Samples s;
  s.count = static_cast<std::int64_t>(samples.size());
  s.min_us = sorted.front();
  s.p50_us = quantile_of_sorted(sorted, 0.5);
  s.p99_us = quantile_of_sorted(sorted, 0.99);
  s.max_us = sorted.back();
  s.max_at = std::max_element(samples.begin(), samples.end()) - samples.begin() + 1;
  if (settled_after <= 0 || !s.spread()) return s;
  Outlier outlier;
  for (const std::int64_t us : samples) {
    ++outlier.later_count;
    if (us > 2 * s.p50_us) {
      ++outlier.count;
      outlier.later_count = 0;
    } else {
      outlier.max_us = std::max(outlier.max_us, us);
    }
  }
  if (outlier.later_count >= settled_after) s.outlier = outlier;
  return s;
}

std::int64_t statistic(const Samples& s, WcetFrom from, std::int64_t margin_pct) {
  const std::int64_t max_us = s.outlier ? s.outlier->max_us : s.max_us;
  switch (from) {
    case WcetFrom::kP50:
      return s.p50_us;
    case WcetFrom::kP99:
      return s.p99_us;
    case WcetFrom::kMaxPlusMargin:
      return max_us + (max_us * margin_pct + 99) / 100;
  }
  return max_us;
}

const char* to_string(Reading::Of of) {
  switch (of) {
    case Reading::Of::kClock:
      return "clock";
    case Reading::Of::kTemperature:
      return "temperature";
    case Reading::Of::kPowerMode:
      return "power_mode";
    case Reading::Of::kGovernor:
      return "governor";
  }
  return "";
}

std::int64_t Reading::jitter(std::int64_t clock) {
  return std::abs(clock) / 100;
}

bool Reading::same_clock(std::int64_t a, std::int64_t b) {
  return std::abs(a - b) <= jitter(std::max(std::abs(a), std::abs(b)));
}

bool Reading::changed() const {
  if (of == Of::kTemperature) return false;
  return of == Of::kClock ? !same_clock(min, max) : texts.size() > 1;
}

namespace {

Status validate(const Samples& s, const std::string& xnode, const std::string& at) {
  if (s.count < 1) return fail(ErrorCode::kInvalid, "no samples", at + "/count");
  if (s.min_us < 0 || s.max_us > kMaxTimeUs || s.min_us > s.p50_us || s.p50_us > s.p99_us ||
      s.p99_us > s.max_us)
    return fail(ErrorCode::kInvalid, "XNode '" + xnode + "': min, p50, p99, max do not ascend", at);
  if (s.max_at > s.count)
    return fail(ErrorCode::kInvalid,
                std::to_string(s.max_at) + " is none of " + std::to_string(s.count) + " samples",
                at + "/max_at");
  if (s.outlier && (s.outlier->max_us < s.min_us || s.outlier->max_us > s.max_us ||
                    s.outlier->count + s.outlier->later_count > s.count))
    return fail(ErrorCode::kInvalid, "is not of these samples", at + "/outlier");
  return {};
}

Status validate(const SamplesByXpu& on,
                const std::map<std::string, SamplesByXpu, std::less<>>& beside,
                const std::string& xnode, const std::string& at) {
  for (const auto& [xpu, s] : on) XAUTO_TRY(validate(s, xnode, at + "/on/" + xpu));
  for (const auto& [type, samples] : beside)
    for (const auto& [xpu, s] : samples)
      XAUTO_TRY(validate(s, xnode, at + "/beside/" + type + "/" + xpu));
  return {};
}

Status validate(const Reading& r, std::set<std::string>& files, const std::string& at) {
  if (r.file.empty() || r.file.front() != '/')
    return fail(ErrorCode::kInvalid, "'" + r.file + "' is not an absolute path", at + "/file");
  if (!files.insert(r.file).second)
    return fail(ErrorCode::kInvalid, "'" + r.file + "' is there twice", at + "/file");
  if (r.is_number()) {
    if (r.min > std::min(r.first, r.last) || std::max(r.first, r.last) > r.max)
      return fail(ErrorCode::kInvalid, "first and last are not between min and max", at);
  } else if (r.texts.empty()) {
    return fail(ErrorCode::kInvalid, "no text", at + "/texts");
  }
  return {};
}

Status validate(const ProgramAsks& asks, const Profile& profile) {
  XAUTO_TRY(validate_names(asks.clocks, "asks/clocks", "clock"));
  for (std::size_t c = 0; c < asks.clocks.size(); ++c)
    XAUTO_TRY(in_range(asks.clocks[c].ppm, 0, kMaxPpm, "a drift in ppm",
                       "/asks/clocks/" + std::to_string(c) + "/ppm"));
  for (std::size_t s = 0; s < profile.sources.size(); ++s)
    if (const int clock = profile.sources[s].clock;
        clock < 0 || static_cast<std::size_t>(clock) >= asks.clocks.size())
      return invalid("names an unknown clock", "/sources/" + std::to_string(s) + "/clock");
  if (asks.deadline_us)
    XAUTO_TRY(in_range(*asks.deadline_us, 1, kMaxTimeUs, "a deadline in us", "/asks/deadline_us"));
  std::set<std::pair<int, int>> pairs;
  for (std::size_t c = 0; c < asks.chains.size(); ++c) {
    const ChainSpec& chain = asks.chains[c];
    const std::string where = "/asks/chains/" + std::to_string(c);
    if (chain.from < 0 || static_cast<std::size_t>(chain.from) >= profile.sources.size())
      return invalid("names an unknown source", where + "/from");
    if (chain.to < 0 || static_cast<std::size_t>(chain.to) >= profile.xnodes.size())
      return invalid("names an unknown XNode", where + "/to");
    if (!chain.deadline_us) return invalid("has no deadline", where);
    XAUTO_TRY(
        in_range(*chain.deadline_us, 1, kMaxTimeUs, "a deadline in us", where + "/deadline_us"));
    if (!pairs.insert({chain.from, chain.to}).second) return invalid("is there twice", where);
  }
  return {};
}

}  // namespace

Status validate(const Profile& profile) {
  if (profile.margin_pct < 0 || profile.margin_pct > 1000)
    return fail(ErrorCode::kInvalid,
                std::to_string(profile.margin_pct) + " is not a margin from 0 to 1000 %",
                "/margin_pct");
  if (profile.xnodes.empty() || profile.xnodes.size() > kMaxXNodes)
    return fail(ErrorCode::kInvalid,
                std::to_string(profile.xnodes.size()) + " XNodes; 1 to " +
                    std::to_string(kMaxXNodes) + " are possible",
                "/xnodes");
  std::set<std::string> files;
  const std::vector<Reading>& readings = profile.conditions.readings;
  for (std::size_t i = 0; i < readings.size(); ++i)
    XAUTO_TRY(validate(readings[i], files, "/conditions/readings/" + std::to_string(i)));
  XAUTO_TRY(validate(profile.sources));
  std::set<std::string> names;
  for (std::size_t i = 0; i < profile.xnodes.size(); ++i) {
    const XNodeProfile& x = profile.xnodes[i];
    const std::string where = "/xnodes/" + std::to_string(i);
    if (x.name.empty()) return fail(ErrorCode::kInvalid, "an XNode needs a name", where + "/name");
    if (!names.insert(x.name).second)
      return fail(ErrorCode::kInvalid, "two XNodes are called '" + x.name + "'", where + "/name");
    XAUTO_TRY(validate(x.on, x.beside, x.name, where));
    XAUTO_TRY(validate_names(x.variants, (where.substr(1) + "/variants").c_str(), "variant"));
    for (std::size_t v = 0; v < x.variants.size(); ++v) {
      const VariantProfile& variant = x.variants[v];
      const std::string here = where + "/variants/" + std::to_string(v);
      XAUTO_TRY(
          in_range(variant.quality_pct, 1, 100, "a quality in percent", here + "/quality_pct"));
      XAUTO_TRY(validate(variant.on, variant.beside, x.name, here));
    }
  }
  for (const auto& [name, pairs] :
       {std::pair("/edges/", &profile.edges), {"/samples/", &profile.sampled}})
    for (std::size_t i = 0; i < pairs->size(); ++i)
      for (const int end : {(*pairs)[i].first, (*pairs)[i].second})
        if (end < 0 || static_cast<std::size_t>(end) >= profile.xnodes.size())
          return fail(ErrorCode::kInvalid, "names an unknown XNode", name + std::to_string(i));
  for (const auto& [module, activations] : profile.in_flight) {
    const std::string where = "/in_flight/" + module;
    if (activations < 1 || activations > kMaxInFlight)
      return fail(ErrorCode::kInvalid,
                  std::to_string(activations) + " is not a number of activations, 1 to " +
                      std::to_string(kMaxInFlight),
                  where);
    if (std::none_of(profile.xnodes.begin(), profile.xnodes.end(),
                     [&name = module](const XNodeProfile& x) { return x.module == name; }))
      return fail(ErrorCode::kInvalid, "no XNode is of that module", where);
  }
  XAUTO_TRY(validate(profile.asks, profile));
  std::set<std::string> optional;
  for (std::size_t k = 0; k < profile.optional.size(); ++k) {
    const std::string where = "/optional/" + std::to_string(k);
    if (!optional.insert(profile.optional[k]).second)
      return invalid("module " + quoted(profile.optional[k]) + " is there twice", where);
    if (std::none_of(profile.xnodes.begin(), profile.xnodes.end(),
                     [&](const XNodeProfile& x) { return x.module == profile.optional[k]; }))
      return invalid("no XNode is of module " + quoted(profile.optional[k]), where);
  }
  std::vector<char> has_predecessor(profile.xnodes.size(), 0);
  for (const auto& [u, v] : profile.edges) has_predecessor[static_cast<std::size_t>(v)] = 1;
  for (std::size_t i = 0; i < profile.xnodes.size(); ++i)
    XAUTO_TRY(validate_heard(profile.xnodes[i].sources, profile.sources.size(),
                             has_predecessor[i] != 0, "/xnodes/" + std::to_string(i) + "/source"));
  return {};
}

namespace {

/// A profile that names no source says nothing of rates: one without a rate fires what nobody else does.
void give_source(AppSpec& app) {
  if (!app.sources.empty()) return;
  app.sources.push_back({"source", kNoRate});
  app.one_at_a_time = true;
  std::vector<char> fired(app.xnodes.size(), 0);
  for (const auto& [u, v] : app.edges) fired[static_cast<std::size_t>(v)] = 1;
  for (std::size_t i = 0; i < app.xnodes.size(); ++i)
    if (fired[i] == 0) app.xnodes[i].sources = {0};
}

/// `rated`, the graph of `profile`, with rates, clocks, samples, and deadlines of chains.
Result<AppSpec> with_rates(const Profile& profile, AppSpec rated) {
  for (SourceSpec& source : rated.sources) source.pushed = false;
  rated.samples = profile.sampled;
  rated.clocks = profile.asks.clocks;
  complete_modules(rated);
  complete_chains(rated);
  give_deadlines(rated);
  XAUTO_TRY(validate(rated));
  for (ModuleSpec& module : rated.modules)
    if (const auto at = profile.in_flight.find(module.name); at != profile.in_flight.end())
      module.max_in_flight = at->second;
  for (const ChainSpec& asked : profile.asks.chains) {
    const auto is_it = [&](const ChainSpec& c) { return c.from == asked.from && c.to == asked.to; };
    auto chain = std::find_if(rated.chains.begin(), rated.chains.end(), is_it);
    if (chain == rated.chains.end()) {  // its end is no last XNode
      rated.chains.push_back(asked);
      chain = std::prev(rated.chains.end());
      chain->name = rated.sources[static_cast<std::size_t>(asked.from)].name + " -> " +
                    rated.xnodes[static_cast<std::size_t>(asked.to)].name;
    }
    chain->deadline_us = asked.deadline_us;
  }
  XAUTO_TRY(validate(rated));
  return rated;
}

}  // namespace

Status can_be_planned(const Profile& profile) {
  AppSpec app;
  app.name = profile.app;
  app.sources = profile.sources;
  app.edges = profile.edges;
  for (const XNodeProfile& x : profile.xnodes)
    app.xnodes.push_back({x.name, x.module, {{"cpu", 1}}, x.sources});
  app.clocks = profile.asks.clocks;
  // The places in these errors are of app.json, which is not there yet.
  if (const Status joins = check_joins(app); !joins)
    return fail(joins.error().code, joins.error().what, profile.app,
                "read one of them by XModule::add_sampled_topic instead of add_input_topic: the "
                "newest, whenever the module fires");
  if (const auto planned = with_rates(profile, std::move(app)); !planned)
    return fail(planned.error().code, planned.error().what, profile.app, planned.error().hint);
  return {};
}

namespace {

const std::string& type_of(const Platform& platform, const std::string& id) {
  return platform.xpus[static_cast<std::size_t>(platform.find(id))].type;
}

/// What becomes of the samples of one XNode.
struct Statistics {
  const Profile& profile;
  const Platform& platform;
  WcetFrom from;
  const std::string& xnode;

  [[nodiscard]] Result<std::int64_t> of(const std::string& id, const Samples& samples) const {
    if (platform.find(id) < 0)
      return fail(ErrorCode::kInvalid,
                  "was measured on '" + id + "', which platform '" + platform.name + "' lacks",
                  "XNode '" + xnode + "'", "use the platform that the profile was taken on");
    if (from == WcetFrom::kP99 && samples.count < kP99Samples)
      return fail(ErrorCode::kInvalid,
                  std::to_string(samples.count) + " samples have no p99: it takes " +
                      std::to_string(kP99Samples),
                  "XNode '" + xnode + "' on " + id, "profile with --repetitions 100 or more");
    return std::max<std::int64_t>(statistic(samples, from, profile.margin_pct), 1);
  }

  template <class Implemented>
  [[nodiscard]] Status take(const SamplesByXpu& on, Implemented& into) const {
    for (const auto& [id, samples] : on) {
      XAUTO_ASSIGN(const std::int64_t us, of(id, samples));
      const std::string& type = type_of(platform, id);
      if (samples.memory_kb)
        into.memory_kb[type] = std::max(into.memory_kb[type], *samples.memory_kb);
      std::int64_t& typical = into.typical_us[type];
      typical = std::max({typical, samples.p50_us, std::int64_t{1}});
      std::int64_t& wcet = into.wcet_us[type];
      wcet = std::max(wcet, us);
    }
    return {};
  }

  /// Above a less urgent one on its own XPU it may be at any time: that is no load of another XPU.
  [[nodiscard]] Status take_beside(const std::map<std::string, SamplesByXpu, std::less<>>& beside,
                                   XNodeSpec& into) const {
    std::map<std::pair<std::string, Load>, std::int64_t> longest;
    std::map<std::string, Load, std::less<>>
        every;  // XPU instance -> all that it was measured beside
    for (const auto& [of_class, on] : beside)
      for (const auto& [id, samples] : on) {
        XAUTO_ASSIGN(const std::int64_t us, of(id, samples));
        const std::string& type = type_of(platform, id);
        const auto wcet = into.wcet_us.find(type);
        if (wcet == into.wcet_us.end()) continue;  // never alone
        const Xpu& xpu = platform.xpus[static_cast<std::size_t>(platform.find(id))];
        if (of_class == kEveryType) continue;
        if (of_class == type && xpu.levels > 0) {
          wcet->second = std::max(wcet->second, us);
          continue;
        }
        const auto loaded = static_cast<std::int64_t>(platform.instances_of(of_class).size()) -
                            (of_class == type ? 1 : 0);
        if (loaded < 1) continue;
        every[id][of_class] = loaded;
        std::int64_t& most = longest[{type, {{of_class, loaded}}}];
        most = std::max(most, us);
      }
    if (const auto all = beside.find(kEveryType); all != beside.end())
      for (const auto& [id, samples] : all->second) {
        XAUTO_ASSIGN(const std::int64_t us, of(id, samples));
        const std::string& type = type_of(platform, id);
        if (!into.wcet_us.contains(type) || every[id].empty()) continue;
        std::int64_t& most = longest[{type, every[id]}];
        most = std::max(most, us);
      }
    for (const auto& [where, us] : longest)
      into.beside.push_back({where.first, where.second, std::max(us, *into.wcet_on(where.first))});
    return {};
  }
};

}  // namespace

Result<AppSpec> to_app(const Profile& profile, const Platform& platform, WcetFrom from) {
  XAUTO_TRY(validate(profile));
  AppSpec app;
  app.name = profile.app;
  app.incomplete = profile.incomplete;
  app.sources = profile.sources;
  app.edges = profile.edges;
  for (const XNodeProfile& x : profile.xnodes) {
    if (x.on.empty())
      return fail(
          ErrorCode::kInvalid, "was not measured on any XPU", "XNode '" + x.name + "'",
          profile.incomplete.empty() ? "" : "the profile is incomplete: " + profile.incomplete);
    XNodeSpec spec{x.name, x.module, {}, x.sources};
    const Statistics of{profile, platform, from, x.name};
    XAUTO_TRY(of.take(x.on, spec));
    XAUTO_TRY(of.take_beside(x.beside, spec));
    for (const VariantProfile& measured : x.variants) {
      VariantSpec variant{measured.name, measured.quality_pct, {}};
      XAUTO_TRY(of.take(measured.on, variant));
      for (const auto& [beside, on] : measured.beside) XAUTO_TRY(of.take(on, variant));
      if (!variant.wcet_us.empty()) spec.variants.push_back(std::move(variant));
    }
    for (const auto& [id, samples] : x.on)
      if (!samples.emulated) spec.real_on.insert(type_of(platform, id));
    app.xnodes.push_back(std::move(spec));
  }
  for (const std::string& module : profile.optional) app.modules.push_back({module, 1, true});
  give_source(app);
  app.deadline_us = profile.asks.deadline_us;
  return with_rates(profile, std::move(app));
}

}  // namespace xauto
