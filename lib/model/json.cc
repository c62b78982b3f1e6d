// SPDX-License-Identifier: Apache-2.0
// Platform and profile; the files. The others: json_app.cc, json_policy.cc. What a JSON text may
// look like at all: json_document.h.
#include "model/json.h"

#include "base/log.h"
#include "model/json_parts.h"
#include "model/json_value.h"

namespace xauto {

using namespace json_parts;

// ---- readers ------------------------------------------------------------------------------------

namespace {

/// Hosts, and the links between them.
NameIndex read_hosts(const Reader& root, Platform& platform) {
  NameIndex index;
  if (root.has("hosts"))
    root["hosts"].each_element(kMaxHosts, [&](std::size_t h, const Reader& x) {
      Host host{x["name"].text()};
      if (x.has("rate_ppm")) host.rate_ppm = x["rate_ppm"].integer(0, kMaxHostPpm);
      index.try_emplace(host.name, static_cast<int>(h));
      platform.hosts.push_back(std::move(host));
    });
  if (root.has("links"))
    root["links"].each_element(kMaxHosts * kMaxHosts, [&](std::size_t, const Reader& x) {
      HostLink link{read_name(x["from"], index, "host", "\"hosts\""),
                    read_name(x["to"], index, "host", "\"hosts\""), x["base_us"].time()};
      if (x.has("mbit_s")) link.mbit_s = x["mbit_s"].integer(1, kMaxMbitS);
      platform.links.push_back(link);
    });
  return index;
}

}  // namespace

Result<Platform> parse_platform(std::string_view text, std::string_view origin, Keys* keys) {
  XAUTO_ASSIGN(const nlohmann::json document, json_document::parse(text, origin));
  Reader::Context context{std::string(origin), {}};
  const Reader root(context, &document, "");
  root.expect("xauto.platform");
  Platform platform;
  platform.name = root["name"].text();
  const NameIndex hosts = read_hosts(root, platform);
  root["xpus"].each_element(kMaxXpus, [&](std::size_t, const Reader& x) {
    Xpu xpu;
    if (!hosts.empty() || x.has("host"))
      xpu.host = read_name(x["host"], hosts, "host", "\"hosts\"");
    xpu.id = x["id"].text();
    xpu.type = x["type"].text();
    if (x.has("preemptive")) xpu.preemptive = x["preemptive"].boolean();
    if (x.has("preempt_us")) xpu.preempt_us = x["preempt_us"].time();
    if (x.has("timeslice_us")) xpu.timeslice_us = x["timeslice_us"].time();
    if (x.has("switch_us")) xpu.switch_us = x["switch_us"].time();
    if (x.has("levels")) xpu.levels = static_cast<int>(x["levels"].integer(0, kMaxLevels));
    if (x.has("preempt_measured")) xpu.preempt_measured = x["preempt_measured"].boolean();
    if (x.has("emulated")) xpu.emulated = x["emulated"].boolean();
    platform.xpus.push_back(std::move(xpu));
  });
  XAUTO_TRY(context.status());
  XAUTO_TRY(in_file(validate(platform), origin));
  if (keys != nullptr) *keys = context.keys(document);
  return platform;
}

namespace {

Samples read_samples(const Reader& s, bool emulated) {
  Samples samples{s["count"].integer(1, kMaxTimeUs), s["min_us"].time(), s["p50_us"].time(),
                  s["p99_us"].time(), s["max_us"].time()};
  samples.emulated = s.has("emulated") ? s["emulated"].boolean() : emulated;
  if (s.has("max_at")) samples.max_at = s["max_at"].integer(1, kMaxTimeUs);
  if (s.has("memory_kb")) samples.memory_kb = s["memory_kb"].integer(0, kMaxMemoryKb);
  if (s.has("outlier")) {
    const Reader o = s["outlier"];
    samples.outlier = {o["count"].integer(1, kMaxTimeUs), o["max_us"].time(),
                       o["later_count"].integer(0, kMaxTimeUs)};
  }
  if (s.has("others"))
    s["others"].each_member(kMaxXpus, [&](const std::string& xpu, const Reader& o) {
      samples.others[xpu] = {o["busy_us"].time(), o["idle_us"].time(), o["used"].boolean()};
    });
  return samples;
}

/// "on" and "beside" of an XNode or a variant.
template <class Measured>
void read_times(const Reader& x, bool emulated, Measured& into) {
  x["on"].each_member(kMaxXpus, [&](const std::string& xpu, const Reader& s) {
    into.on[xpu] = read_samples(s, emulated);
  });
  if (x.has("beside"))
    x["beside"].each_member(kMaxXpus, [&](const std::string& type, const Reader& on) {
      on.each_member(kMaxXpus, [&](const std::string& xpu, const Reader& s) {
        into.beside[type][xpu] = read_samples(s, emulated);
      });
    });
}

Reading read_reading(const Reader& r) {
  using Of = Reading::Of;
  Reading reading;
  const std::string of = r["of"].text();
  bool known = false;
  for (const Of kind : {Of::kClock, Of::kTemperature, Of::kPowerMode, Of::kGovernor})
    if (of == to_string(kind)) {
      reading.of = kind;
      known = true;
    }
  if (!known) r["of"].refuse("'" + of + "' is none of clock, temperature, power_mode, governor");
  reading.file = r["file"].text();
  if (r.has("name")) reading.name = r["name"].text();
  if (reading.is_number()) {
    reading.first = r["first"].integer(-kMaxReading, kMaxReading);
    reading.min = r["min"].integer(-kMaxReading, kMaxReading);
    reading.max = r["max"].integer(-kMaxReading, kMaxReading);
    reading.last = r["last"].integer(-kMaxReading, kMaxReading);
  } else {
    r["texts"].each_element(kMaxReadingTexts, [&](std::size_t, const Reader& text) {
      reading.texts.push_back(text.text());
    });
  }
  return reading;
}
/// Clocks, and which source has which; "main" is the first, and need not be listed.
void read_clocks(const Reader& root, Profile& profile) {
  std::vector<ClockSpec>& clocks = profile.asks.clocks;
  if (root.has("asks") && root["asks"].has("clocks"))
    root["asks"]["clocks"].each_element(kMaxSources, [&](std::size_t, const Reader& c) {
      ClockSpec clock{c["name"].text(), c["ppm"].integer(0, kMaxPpm)};
      if (clock.name == kMainClock)
        clocks.front() = std::move(clock);
      else
        clocks.push_back(std::move(clock));
    });
  const NameIndex index = index_by_name(clocks);
  if (root.has("sources"))
    root["sources"].each_element(kMaxSources, [&](std::size_t s, const Reader& source) {
      if (source.has("clock") && s < profile.sources.size())
        profile.sources[s].clock = read_name(source["clock"], index, "clock", "\"asks\"");
    });
}

void read_deadlines(const Reader& asks, const NameIndex& sources, Profile& profile) {
  if (asks.has("deadline_us"))
    profile.asks.deadline_us = asks["deadline_us"].integer(1, kMaxTimeUs);
  const NameIndex xnodes = index_by_name(profile.xnodes);
  if (asks.has("chains"))
    asks["chains"].each_element(kMaxAppChains, [&](std::size_t, const Reader& c) {
      ChainSpec chain;
      chain.from = read_name(c["from"], sources, "source", "\"sources\"");
      chain.to = read_name(c["to"], xnodes, "XNode", "the profile");
      chain.deadline_us = c["deadline_us"].integer(1, kMaxTimeUs);
      profile.asks.chains.push_back(std::move(chain));
    });
}

ordered_json asks_to_json(const Profile& profile) {
  ordered_json asks = ordered_json::object();
  for (const ClockSpec& clock : profile.asks.clocks)
    if (clock != ClockSpec{kMainClock, 0})
      asks["clocks"].push_back({{"name", clock.name}, {"ppm", clock.ppm}});
  if (profile.asks.deadline_us) asks["deadline_us"] = *profile.asks.deadline_us;
  for (const ChainSpec& c : profile.asks.chains)
    asks["chains"].push_back({{"from", profile.sources[static_cast<std::size_t>(c.from)].name},
                              {"to", profile.xnodes[static_cast<std::size_t>(c.to)].name},
                              {"deadline_us", c.deadline_us.value_or(kMaxTimeUs)}});
  return asks;
}

/// Rates, whether they are pushed, and how late their releases were; none: nothing is known.
std::vector<SourceSpec> read_sources(const Reader& root) {
  std::vector<SourceSpec> sources;
  if (root.has("sources"))
    root["sources"].each_element(kMaxSources, [&](std::size_t, const Reader& source) {
      sources.push_back({source["name"].text(), read_period(source)});
      if (source.has("pushed")) sources.back().pushed = source["pushed"].boolean();
      if (source.has("jitter_us"))
        sources.back().jitter_us = source["jitter_us"].integer(0, kMaxPeriodUs);
    });
  return sources;
}

ordered_json sources_to_json(const std::vector<SourceSpec>& sources) {
  ordered_json out = ordered_json::array();
  for (const SourceSpec& source : sources) {
    ordered_json one = {{"name", source.name}};
    write_period(source.period, one);
    if (source.pushed) one["pushed"] = true;
    if (source.jitter_us != 0) one["jitter_us"] = source.jitter_us;
    out.push_back(std::move(one));
  }
  return out;
}

}  // namespace

Result<Profile> parse_profile(std::string_view text, std::string_view origin, Keys* keys) {
  XAUTO_ASSIGN(const nlohmann::json document, json_document::parse(text, origin));
  Reader::Context context{std::string(origin), {}};
  const Reader root(context, &document, "");
  root.expect("xauto.profile");
  Profile profile;
  profile.app = root["app"].text();
  const Reader conditions = root["conditions"];
  ProfileConditions& c = profile.conditions;
  c.machine = conditions["machine"].text();
  c.platform = conditions["platform"].text();
  c.emulated = conditions["emulated"].boolean();
  c.input = conditions["input"].text();
  c.warmup = conditions["warmup"].integer(0, kMaxTimeUs);
  c.repetitions = conditions["repetitions"].integer(0, kMaxTimeUs);
  c.governor = conditions["governor"].text();
  if (conditions.has("readings"))
    conditions["readings"].each_element(
        kMaxReadings, [&](std::size_t, const Reader& r) { c.readings.push_back(read_reading(r)); });
  for (const auto& [key, texts] :
       {std::pair("beside", &c.beside), std::pair("not_beside", &c.not_beside)})
    if (conditions.has(key))
      conditions[key].each_member(kMaxXpus,
                                  [&, to = texts](const std::string& type, const Reader& what) {
                                    (*to)[type] = what.text();
                                  });
  profile.margin_pct = root["margin_pct"].integer(0, 1000);
  profile.sources = read_sources(root);
  read_clocks(root, profile);
  const NameIndex source_index = index_by_name(profile.sources);
  if (root.has("incomplete")) profile.incomplete = root["incomplete"].text();
  root["xnodes"].each_element(kMaxXNodes, [&](std::size_t, const Reader& x) {
    XNodeProfile node{x["name"].text(), x["module"].text(), {}};
    read_times(x, c.emulated, node);
    if (x.has("variants"))
      x["variants"].each_element(kMaxVariants, [&](std::size_t, const Reader& v) {
        VariantProfile variant{v["name"].text(), v["quality_pct"].integer(1, 100)};
        read_times(v, c.emulated, variant);
        node.variants.push_back(std::move(variant));
      });
    node.sources = read_heard(x, source_index);
    if (x.has("missing"))
      x["missing"].each_element(
          kMaxXpus, [&](std::size_t, const Reader& xpu) { node.missing.push_back(xpu.text()); });
    profile.xnodes.push_back(std::move(node));
  });
  XAUTO_TRY(context.status());
  XAUTO_TRY(in_file(validate(profile), origin));
  profile.edges = read_pairs(root["edges"], index_by_name(profile.xnodes));
  if (root.has("samples"))
    profile.sampled = read_pairs(root["samples"], index_by_name(profile.xnodes));
  if (root.has("asks")) read_deadlines(root["asks"], source_index, profile);
  if (root.has("in_flight"))
    root["in_flight"].each_member(kMaxXNodes, [&](const std::string& module, const Reader& n) {
      profile.in_flight[module] = n.integer(1, kMaxInFlight);
    });
  if (root.has("optional"))
    root["optional"].each_element(kMaxXNodes, [&](std::size_t, const Reader& module) {
      profile.optional.push_back(module.text());
    });
  XAUTO_TRY(context.status());
  XAUTO_TRY(in_file(validate(profile), origin));
  if (keys != nullptr) *keys = context.keys(document);
  return profile;
}

// ---- writers ------------------------------------------------------------------------------------

std::string to_json(const Platform& platform) {
  ordered_json xpus = ordered_json::array();
  for (const Xpu& x : platform.xpus) {
    ordered_json xpu = {{"id", x.id},
                        {"type", x.type},
                        {"preemptive", x.preemptive},
                        {"preempt_us", x.preempt_us},
                        {"timeslice_us", x.timeslice_us}};
    if (x.switch_us >= 0) xpu["switch_us"] = x.switch_us;
    if (x.levels > 0) xpu["levels"] = x.levels;
    if (!x.preempt_measured) xpu["preempt_measured"] = false;
    if (x.emulated) xpu["emulated"] = *x.emulated;
    if (!platform.hosts.empty())
      xpu["host"] = platform.hosts[static_cast<std::size_t>(x.host)].name;
    xpus.push_back(std::move(xpu));
  }
  ordered_json document = {{"schema", "xauto.platform"}, {"version", 1}, {"name", platform.name}};
  for (const Host& host : platform.hosts)
    document["hosts"].push_back({{"name", host.name}, {"rate_ppm", host.rate_ppm}});
  for (const HostLink& link : platform.links) {
    document["links"].push_back({{"from", platform.hosts[static_cast<std::size_t>(link.from)].name},
                                 {"to", platform.hosts[static_cast<std::size_t>(link.to)].name},
                                 {"base_us", link.base_us}});
    if (link.mbit_s > 0) document["links"].back()["mbit_s"] = link.mbit_s;
  }
  document["xpus"] = std::move(xpus);
  return json_document::to_text(document);
}

namespace {

ordered_json samples_to_json(const Samples& s, bool emulated) {
  ordered_json entry = {{"count", s.count},
                        {"min_us", s.min_us},
                        {"p50_us", s.p50_us},
                        {"p99_us", s.p99_us},
                        {"max_us", s.max_us}};
  if (s.max_at > 0) entry["max_at"] = s.max_at;
  if (s.memory_kb) entry["memory_kb"] = *s.memory_kb;
  if (s.emulated != emulated) entry["emulated"] = s.emulated;
  if (s.outlier)
    entry["outlier"] = {{"count", s.outlier->count},
                        {"max_us", s.outlier->max_us},
                        {"later_count", s.outlier->later_count}};
  for (const auto& [xpu, o] : s.others)
    entry["others"][xpu] = {{"busy_us", o.busy_us}, {"idle_us", o.idle_us}, {"used", o.used}};
  return entry;
}

void write_on(const SamplesByXpu& on, bool emulated, ordered_json& into) {
  into["on"] = ordered_json::object();
  for (const auto& [xpu, s] : on) into["on"][xpu] = samples_to_json(s, emulated);
}

void write_beside(const std::map<std::string, SamplesByXpu, std::less<>>& beside, bool emulated,
                  ordered_json& into) {
  for (const auto& [type, samples] : beside)
    for (const auto& [xpu, s] : samples) into["beside"][type][xpu] = samples_to_json(s, emulated);
}

ordered_json reading_to_json(const Reading& r) {
  ordered_json entry = {{"of", to_string(r.of)}, {"file", r.file}};
  if (!r.name.empty()) entry["name"] = r.name;
  if (r.is_number()) {
    entry["first"] = r.first;
    entry["min"] = r.min;
    entry["max"] = r.max;
    entry["last"] = r.last;
  } else {
    entry["texts"] = r.texts;
  }
  return entry;
}

}  // namespace

std::string to_json(const Profile& profile) {
  const ProfileConditions& c = profile.conditions;
  ordered_json xnodes = ordered_json::array();
  for (const XNodeProfile& x : profile.xnodes) {
    ordered_json xnode = {{"name", x.name}, {"module", x.module}};
    write_heard(x.sources, profile.sources, xnode);
    write_on(x.on, c.emulated, xnode);
    if (!x.missing.empty()) xnode["missing"] = x.missing;
    write_beside(x.beside, c.emulated, xnode);
    for (const VariantProfile& v : x.variants) {
      ordered_json variant = {{"name", v.name}, {"quality_pct", v.quality_pct}};
      write_on(v.on, c.emulated, variant);
      write_beside(v.beside, c.emulated, variant);
      xnode["variants"].push_back(std::move(variant));
    }
    xnodes.push_back(std::move(xnode));
  }
  ordered_json document = {{"schema", "xauto.profile"}, {"version", 1}, {"app", profile.app}};
  document["conditions"] = {{"machine", c.machine},   {"platform", c.platform},
                            {"emulated", c.emulated}, {"input", c.input},
                            {"warmup", c.warmup},     {"repetitions", c.repetitions},
                            {"governor", c.governor}};
  ordered_json& conditions = document["conditions"];
  for (const Reading& reading : c.readings)
    conditions["readings"].push_back(reading_to_json(reading));
  if (!c.beside.empty()) conditions["beside"] = c.beside;
  if (!c.not_beside.empty()) conditions["not_beside"] = c.not_beside;
  document["margin_pct"] = profile.margin_pct;
  if (!profile.sources.empty()) document["sources"] = sources_to_json(profile.sources);
  for (std::size_t s = 0; s < profile.sources.size(); ++s)
    if (const int clock = profile.sources[s].clock; clock != 0)
      document["sources"][s]["clock"] = profile.asks.clocks[static_cast<std::size_t>(clock)].name;
  if (!profile.incomplete.empty()) document["incomplete"] = profile.incomplete;
  document["xnodes"] = std::move(xnodes);
  const auto name = [&](int i) { return profile.xnodes[static_cast<std::size_t>(i)].name; };
  document["edges"] = pairs_to_json(profile.edges, name);
  if (!profile.sampled.empty()) document["samples"] = pairs_to_json(profile.sampled, name);
  if (!profile.in_flight.empty()) document["in_flight"] = profile.in_flight;
  if (!profile.optional.empty()) document["optional"] = profile.optional;
  if (!profile.asks.nothing()) document["asks"] = asks_to_json(profile);
  return json_document::to_text(document);
}

// ---- files --------------------------------------------------------------------------------------

Result<AppSpec> load_app(const std::string& path) {
  XAUTO_ASSIGN(const std::string text, read_file(path));
  Keys keys;
  XAUTO_ASSIGN(AppSpec app, parse_app(text, path, &keys));
  XAUTO_TRY(judge(keys, path));
  if (!app.incomplete.empty())
    log::warn("{}: its WCETs are of an incomplete profile: {}", path, app.incomplete);
  return app;
}

Result<Platform> load_platform(const std::string& name_or_path) {
  if (auto builtin = Platform::builtin(name_or_path)) return builtin;
  auto text = read_file(name_or_path);
  if (!text) {
    Error error = std::move(text).error();
    error.hint = std::string("use ") + kPlatformNames;
    return tl::unexpected<Error>(std::move(error));
  }
  Keys keys;
  XAUTO_ASSIGN(Platform platform, parse_platform(*text, name_or_path, &keys));
  XAUTO_TRY(judge(keys, name_or_path));
  return platform;
}

Result<Platform> load_platform_of(const std::string& policy_path, const std::string& name_or_path) {
  if (!name_or_path.empty()) return load_platform(name_or_path);
  std::string named;
  // A file that is missing or malformed is told by whoever reads all of it.
  if (const auto text = read_file(policy_path))
    if (const auto document = Json::parse(*text))
      named = document->at("platform").text().value_or("");
  if (named.empty()) return load_platform("small");
  if (auto builtin = Platform::builtin(named)) return builtin;
  return fail(ErrorCode::kInvalid,
              "was made for platform '" + named + "', which does not come with XAuto", policy_path,
              "give its file: --platform FILE");
}

Result<Profile> load_profile(const std::string& path) {
  XAUTO_ASSIGN(const std::string text, read_file(path));
  Keys keys;
  XAUTO_ASSIGN(Profile profile, parse_profile(text, path, &keys));
  XAUTO_TRY(judge(keys, path));
  return profile;
}

Result<Policy> load_policy(const std::string& path, const AppSpec& app, const Platform& platform) {
  XAUTO_ASSIGN(const std::string text, read_file(path));
  Keys keys;
  XAUTO_ASSIGN(Policy policy, parse_policy(text, path, app, platform, &keys));
  XAUTO_TRY(judge(keys, path));
  return policy;
}

Result<Policy> load_key_hint(const std::string& path, const AppSpec& app,
                             const Platform& platform) {
  XAUTO_ASSIGN(const std::string text, read_file(path));
  return parse_key_hint(text, path, app, platform);
}

}  // namespace xauto
