// SPDX-License-Identifier: Apache-2.0
// One reader and one writer per format. What a JSON text may look like at all: json_document.h.
#include "model/json.h"

#include <algorithm>
#include <cstdint>
#include <optional>
#include <unordered_map>

#include <nlohmann/json.hpp>

#include "model/claims.h"
#include "model/json_document.h"

namespace xauto {
namespace {

using json_document::Reader;
using nlohmann::ordered_json;

/// Puts the file's name before the place that a validator names.
Status in_file(Status status, std::string_view origin) {
  if (status) return status;
  Error error = std::move(status).error();
  error.where =
      error.where.empty() ? std::string(origin) : std::string(origin) + ": " + error.where;
  return tl::unexpected<Error>(std::move(error));
}

/// A validator counts XNodes as the app does; the file may list them in another order.
Status in_file_order(Error error, const std::vector<std::size_t>& line_of) {
  constexpr std::string_view kPlace = "/xnodes/";
  if (error.where.starts_with(kPlace)) {
    const std::size_t end = std::min(error.where.find('/', kPlace.size()), error.where.size());
    const std::size_t index = std::stoul(error.where.substr(kPlace.size(), end - kPlace.size()));
    error.where = std::string(kPlace) + std::to_string(line_of.at(index)) + error.where.substr(end);
  }
  return tl::unexpected<Error>(std::move(error));
}

/// [["u", "v"], …] by XNode name.
using NameIndex = std::unordered_map<std::string, int>;
std::vector<std::pair<int, int>> read_pairs(const Reader& reader, const NameIndex& index) {
  std::vector<std::pair<int, int>> pairs;
  reader.each_element(kMaxEdges, [&](std::size_t, const Reader& pair) {
    int ends[2] = {-1, -1};
    std::size_t count = 0;
    pair.each_element(2, [&](std::size_t i, const Reader& end) {
      const std::string name = end.text();
      if (end.failed()) return;
      const auto found = index.find(name);
      if (found == index.end()) return end.refuse("XNode '" + name + "' is not in the app");
      ends[i] = found->second;
      ++count;
    });
    if (!pair.failed() && count != 2) pair.refuse("must name two XNodes");
    pairs.emplace_back(ends[0], ends[1]);
  });
  return pairs;
}

template <class Node>
NameIndex index_by_name(const std::vector<Node>& nodes) {
  NameIndex index;
  for (std::size_t i = 0; i < nodes.size(); ++i)
    index.try_emplace(nodes[i].name, static_cast<int>(i));
  return index;
}

std::vector<SourceSpec> read_sources(const Reader& root) {
  std::vector<SourceSpec> sources;
  if (root.has("sources"))
    root["sources"].each_element(kMaxSources, [&](std::size_t, const Reader& source) {
      sources.push_back({source["name"].text(), {source["period_us"].integer(1, kMaxPeriodUs)}});
    });
  return sources;
}

/// "source" of an XNode: a name, or an array of names.
std::vector<int> read_heard(const Reader& xnode, const NameIndex& sources) {
  std::vector<int> heard;
  if (!xnode.has("source")) return heard;
  const auto read = [&](const Reader& one) {
    const std::string name = one.text();
    if (one.failed()) return;
    const auto found = sources.find(name);
    if (found == sources.end()) return one.refuse("source '" + name + "' is not in \"sources\"");
    heard.push_back(found->second);
  };
  const Reader source = xnode["source"];
  if (source.is_text())
    read(source);
  else
    source.each_element(kMaxSources, [&](std::size_t, const Reader& one) { read(one); });
  return heard;
}

void write_heard(const std::vector<int>& heard, const std::vector<SourceSpec>& sources,
                 ordered_json& xnode) {
  ordered_json names = ordered_json::array();
  for (const int s : heard) names.push_back(sources[static_cast<std::size_t>(s)].name);
  if (heard.size() == 1) xnode["source"] = names.front();
  if (heard.size() > 1) xnode["source"] = std::move(names);
}

ordered_json sources_to_json(const std::vector<SourceSpec>& sources) {
  ordered_json out = ordered_json::array();
  for (const SourceSpec& source : sources)
    out.push_back({{"name", source.name}, {"period_us", source.period.num}});
  return out;
}

template <class Names>
ordered_json pairs_to_json(const std::vector<std::pair<int, int>>& pairs, const Names& name) {
  ordered_json out = ordered_json::array();
  for (const auto& [u, v] : pairs) out.push_back({name(u), name(v)});
  return out;
}

std::string dump(const ordered_json& document) {
  return json_document::to_text(document);
}

}  // namespace

// ---- readers ------------------------------------------------------------------------------------

Result<AppSpec> parse_app(std::string_view text, std::string_view origin, Keys* keys) {
  XAUTO_ASSIGN(const nlohmann::json document, json_document::parse(text, origin));
  Reader::Context context{std::string(origin), {}};
  const Reader root(context, &document, "");
  root.expect("xauto.app");
  // What is asked of the solver; tools/xauto/objectives_file.h reads it.
  root.knows({"chains/*/name", "chains/*/from", "chains/*/to", "chains/*/deadline_us",
              "chains/*/weight", "pins/*/xnode", "pins/*/xpu", "forbids/*/xnode", "forbids/*/xpu",
              "groups"});
  AppSpec app;
  app.name = root["name"].text();
  app.sources = read_sources(root);
  const NameIndex source_index = index_by_name(app.sources);
  root["xnodes"].each_element(kMaxXNodes, [&](std::size_t, const Reader& x) {
    XNodeSpec spec{x["name"].text(), x["module"].text(), {}};
    x["wcet_us"].each_member(kMaxXpus, [&](const std::string& type, const Reader& us) {
      spec.wcet_us[type] = us.integer(1, kMaxTimeUs);
    });
    spec.sources = read_heard(x, source_index);
    if (x.has("real_on"))
      x["real_on"].each_element(kMaxXpus, [&](std::size_t, const Reader& type) {
        const std::string name = type.text();
        if (!type.failed() && !spec.wcet_us.contains(name))
          return type.refuse("'" + name + "' is no key of wcet_us");
        spec.real_on.insert(name);
      });
    app.xnodes.push_back(std::move(spec));
  });
  XAUTO_TRY(context.status());
  XAUTO_TRY(in_file(validate(app), origin));  // before its XNodes are looked up by name
  app.edges = read_pairs(root["edges"], index_by_name(app.xnodes));
  if (root.has("deadline_us")) app.deadline_us = root["deadline_us"].integer(1, kMaxTimeUs);
  XAUTO_TRY(context.status());
  XAUTO_TRY(in_file(validate(app), origin));
  if (keys != nullptr) *keys = context.keys(document);
  return app;
}

Result<Platform> parse_platform(std::string_view text, std::string_view origin, Keys* keys) {
  XAUTO_ASSIGN(const nlohmann::json document, json_document::parse(text, origin));
  Reader::Context context{std::string(origin), {}};
  const Reader root(context, &document, "");
  root.expect("xauto.platform");
  Platform platform;
  platform.name = root["name"].text();
  root["xpus"].each_element(kMaxXpus, [&](std::size_t, const Reader& x) {
    Xpu xpu;
    xpu.id = x["id"].text();
    xpu.type = x["type"].text();
    if (x.has("preemptive")) xpu.preemptive = x["preemptive"].boolean();
    if (x.has("preempt_us")) xpu.preempt_us = x["preempt_us"].time();
    if (x.has("timeslice_us")) xpu.timeslice_us = x["timeslice_us"].time();
    if (x.has("switch_us")) xpu.switch_us = x["switch_us"].time();
    if (x.has("emulated")) xpu.emulated = x["emulated"].boolean();
    platform.xpus.push_back(std::move(xpu));
  });
  XAUTO_TRY(context.status());
  XAUTO_TRY(in_file(validate(platform), origin));
  if (keys != nullptr) *keys = context.keys(document);
  return platform;
}

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
  profile.margin_pct = root["margin_pct"].integer(0, 1000);
  profile.sources = read_sources(root);
  const NameIndex source_index = index_by_name(profile.sources);
  if (root.has("incomplete")) profile.incomplete = root["incomplete"].text();
  root["xnodes"].each_element(kMaxXNodes, [&](std::size_t, const Reader& x) {
    XNodeProfile node{x["name"].text(), x["module"].text(), {}};
    x["on"].each_member(kMaxXpus, [&](const std::string& xpu, const Reader& s) {
      Samples& samples = node.on[xpu];
      samples = {s["count"].integer(1, kMaxTimeUs), s["min_us"].time(), s["p50_us"].time(),
                 s["p99_us"].time(), s["max_us"].time()};
      samples.emulated = s.has("emulated") ? s["emulated"].boolean() : c.emulated;
      if (s.has("max_at")) samples.max_at = s["max_at"].integer(1, kMaxTimeUs);
      if (s.has("outlier")) {
        const Reader o = s["outlier"];
        samples.outlier = {o["count"].integer(1, kMaxTimeUs), o["max_us"].time(),
                           o["later_count"].integer(0, kMaxTimeUs)};
      }
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
  XAUTO_TRY(context.status());
  XAUTO_TRY(in_file(validate(profile), origin));
  if (keys != nullptr) *keys = context.keys(document);
  return profile;
}

Result<Policy> parse_policy(std::string_view text, std::string_view origin, const AppSpec& app,
                            const Platform& platform, Keys* keys) {
  XAUTO_ASSIGN(const nlohmann::json document, json_document::parse(text, origin));
  Reader::Context context{std::string(origin), {}};
  const Reader root(context, &document, "");
  root.expect("xauto.policy");
  Policy policy;
  policy.app = root["app"].text();
  policy.app_hash = root["app_hash"].text();
  if (root.has("platform")) policy.platform = root["platform"].text();
  policy.method = root["method"].text();
  const NameIndex index = index_by_name(app.xnodes);
  policy.placements.resize(app.xnodes.size());
  constexpr std::size_t kNowhere = SIZE_MAX;
  std::vector<std::size_t> line_of(app.xnodes.size(),
                                   kNowhere);  // XNode of the app -> element of the file
  root["xnodes"].each_element(kMaxXNodes, [&](std::size_t line, const Reader& x) {
    const std::string name = x["name"].text();
    if (x.failed()) return;
    const auto found = index.find(name);
    if (found == index.end()) return x["name"].refuse("XNode '" + name + "' is not in the app");
    const auto i = static_cast<std::size_t>(found->second);
    if (line_of[i] != kNowhere) return x["name"].refuse("XNode '" + name + "' is placed twice");
    line_of[i] = line;
    const std::string xpu = x["xpu"].text();
    Placement& p = policy.placements[i];
    p.xpu = platform.find(xpu);
    if (!x.failed() && p.xpu < 0)
      return x["xpu"].refuse("XPU '" + xpu + "' is not in platform '" + platform.name + "'");
    p.priority = x["priority"].integer(-kMaxTimeUs, kMaxTimeUs);
    p.start_us = x["start_us"].time();
    p.finish_us = x["finish_us"].time();
  });
  if (!root.failed())
    for (std::size_t i = 0; i < line_of.size(); ++i)
      if (line_of[i] == kNowhere) {
        root["xnodes"].refuse("XNode '" + app.xnodes[i].name + "' is not placed");
        break;
      }
  if (root.has("order")) policy.order = read_pairs(root["order"], index);
  policy.latency_us = root["latency_us"].time();
  policy.lower_bound_us = root["lower_bound_us"].time();
  policy.optimal = root["optimal"].boolean();
  if (root.has("worst_case_us")) policy.worst_case_us = root["worst_case_us"].time();
  if (root.has("worst_case_of")) (void)root["worst_case_of"].text();  // for people
  if (root.has("solve_ms")) policy.solve_ms = root["solve_ms"].integer(0, kMaxTimeUs);
  XAUTO_TRY(context.status());
  Status valid = validate(policy, app, platform);
  if (!valid) valid = in_file_order(std::move(valid).error(), line_of);
  XAUTO_TRY(in_file(std::move(valid), origin));
  if (keys != nullptr) *keys = context.keys(document);
  return policy;
}

// ---- writers ------------------------------------------------------------------------------------

std::string to_json(const AppSpec& app) {
  ordered_json xnodes = ordered_json::array();
  for (const XNodeSpec& x : app.xnodes) {
    ordered_json xnode = {{"name", x.name}, {"module", x.module}};
    write_heard(x.sources, app.sources, xnode);
    xnode["wcet_us"] = ordered_json(x.wcet_us);
    if (!x.real_on.empty()) xnode["real_on"] = x.real_on;
    xnodes.push_back(std::move(xnode));
  }
  ordered_json document = {{"schema", "xauto.app"}, {"version", 1}, {"name", app.name}};
  if (!app.sources.empty()) document["sources"] = sources_to_json(app.sources);
  document["xnodes"] = std::move(xnodes);
  document["edges"] =
      pairs_to_json(app.edges, [&](int i) { return app.xnodes[static_cast<std::size_t>(i)].name; });
  if (app.deadline_us) document["deadline_us"] = *app.deadline_us;
  return dump(document);
}

std::string to_json(const Platform& platform) {
  ordered_json xpus = ordered_json::array();
  for (const Xpu& x : platform.xpus) {
    ordered_json xpu = {{"id", x.id},
                        {"type", x.type},
                        {"preemptive", x.preemptive},
                        {"preempt_us", x.preempt_us},
                        {"timeslice_us", x.timeslice_us}};
    if (x.switch_us >= 0) xpu["switch_us"] = x.switch_us;
    if (x.emulated) xpu["emulated"] = *x.emulated;
    xpus.push_back(std::move(xpu));
  }
  ordered_json document = {{"schema", "xauto.platform"}, {"version", 1}, {"name", platform.name}};
  document["xpus"] = std::move(xpus);
  return dump(document);
}

std::string to_json(const Profile& profile) {
  const ProfileConditions& c = profile.conditions;
  ordered_json xnodes = ordered_json::array();
  for (const XNodeProfile& x : profile.xnodes) {
    ordered_json on = ordered_json::object();
    for (const auto& [xpu, s] : x.on) {
      ordered_json& entry = on[xpu];
      entry = {{"count", s.count},
               {"min_us", s.min_us},
               {"p50_us", s.p50_us},
               {"p99_us", s.p99_us},
               {"max_us", s.max_us}};
      if (s.max_at > 0) entry["max_at"] = s.max_at;
      if (s.emulated != c.emulated) entry["emulated"] = s.emulated;
      if (s.outlier)
        entry["outlier"] = {{"count", s.outlier->count},
                            {"max_us", s.outlier->max_us},
                            {"later_count", s.outlier->later_count}};
    }
    ordered_json xnode = {{"name", x.name}, {"module", x.module}};
    write_heard(x.sources, profile.sources, xnode);
    xnode["on"] = std::move(on);
    if (!x.missing.empty()) xnode["missing"] = x.missing;
    xnodes.push_back(std::move(xnode));
  }
  ordered_json document = {{"schema", "xauto.profile"}, {"version", 1}, {"app", profile.app}};
  document["conditions"] = {{"machine", c.machine},   {"platform", c.platform},
                            {"emulated", c.emulated}, {"input", c.input},
                            {"warmup", c.warmup},     {"repetitions", c.repetitions},
                            {"governor", c.governor}};
  document["margin_pct"] = profile.margin_pct;
  if (!profile.sources.empty()) document["sources"] = sources_to_json(profile.sources);
  if (!profile.incomplete.empty()) document["incomplete"] = profile.incomplete;
  document["xnodes"] = std::move(xnodes);
  document["edges"] = pairs_to_json(
      profile.edges, [&](int i) { return profile.xnodes[static_cast<std::size_t>(i)].name; });
  return dump(document);
}

std::string to_json(const Policy& policy, const AppSpec& app, const Platform& platform) {
  const auto name = [&](int i) { return app.xnodes[static_cast<std::size_t>(i)].name; };
  ordered_json xnodes = ordered_json::array();
  for (std::size_t i = 0; i < policy.placements.size(); ++i) {
    const Placement& p = policy.placements[i];
    xnodes.push_back({{"name", app.xnodes[i].name},
                      {"xpu", platform.xpus[static_cast<std::size_t>(p.xpu)].id},
                      {"priority", p.priority},
                      {"start_us", p.start_us},
                      {"finish_us", p.finish_us}});
  }
  ordered_json document = {{"schema", "xauto.policy"},    {"version", 1},
                           {"app", policy.app},           {"app_hash", policy.app_hash},
                           {"platform", policy.platform}, {"method", policy.method}};
  document["xnodes"] = std::move(xnodes);
  if (!policy.order.empty()) document["order"] = pairs_to_json(policy.order, name);
  document["latency_us"] = policy.latency_us;
  document["lower_bound_us"] = policy.lower_bound_us;
  document["optimal"] = policy.optimal;
  if (policy.worst_case_us) {
    document["worst_case_us"] = *policy.worst_case_us;
    document["worst_case_of"] = kWorstCaseScope;
  }
  document["solve_ms"] = policy.solve_ms;
  return dump(document);
}

// ---- files --------------------------------------------------------------------------------------

Result<AppSpec> load_app(const std::string& path) {
  XAUTO_ASSIGN(const std::string text, read_file(path));
  Keys keys;
  XAUTO_ASSIGN(AppSpec app, parse_app(text, path, &keys));
  XAUTO_TRY(judge(keys, path));
  return app;
}

Result<Platform> load_platform(const std::string& name_or_path) {
  if (auto builtin = Platform::builtin(name_or_path)) return builtin;
  auto text = read_file(name_or_path);
  if (!text) {
    Error error = std::move(text).error();
    error.hint = "use small, large, or the path of a platform.json";
    return tl::unexpected<Error>(std::move(error));
  }
  Keys keys;
  XAUTO_ASSIGN(Platform platform, parse_platform(*text, name_or_path, &keys));
  XAUTO_TRY(judge(keys, name_or_path));
  return platform;
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

}  // namespace xauto
