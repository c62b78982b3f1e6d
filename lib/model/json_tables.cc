// SPDX-License-Identifier: Apache-2.0
// scenarios.json and tables.json.
#include <algorithm>
#include <cstdint>
#include <utility>

#include "model/json.h"
#include "model/json_parts.h"
#include "model/json_value.h"
#include "model/tables.h"

namespace xauto {

using namespace json_parts;

namespace {

Scenario read_scenario(const Reader& x) {
  Scenario s;
  s.name = x["name"].text();
  if (x.has("wcet_scale_pct"))
    x["wcet_scale_pct"].each_member(kMaxXpus, [&](const std::string& type, const Reader& pct) {
      s.wcet_scale_pct[type] = pct.integer(1, kMaxScalePct);
    });
  if (x.has("wcet_us"))
    x["wcet_us"].each_member(kMaxXNodes, [&](const std::string& xnode, const Reader& on) {
      on.each_member(kMaxXpus, [&](const std::string& type, const Reader& us) {
        s.wcet_us[xnode][type] = us.integer(1, kMaxTimeUs);
      });
    });
  if (x.has("lost"))
    x["lost"].each_element(kMaxXpus,
                           [&](std::size_t, const Reader& id) { s.lost.push_back(id.text()); });
  if (x.has("when"))
    x["when"].each_element(kMaxConditions, [&](std::size_t, const Reader& c) {
      Condition condition;
      condition.file = c["file"].text();
      if (c.has("at_least")) condition.at_least = c["at_least"].integer(-kMaxReading, kMaxReading);
      if (c.has("at_most")) condition.at_most = c["at_most"].integer(-kMaxReading, kMaxReading);
      if (c.has("equals")) condition.equals = c["equals"].text();
      s.when.push_back(std::move(condition));
    });
  if (x.has("degraded")) s.degraded = x["degraded"].boolean();
  if (x.has("variant_wcet_us"))
    x["variant_wcet_us"].each_member(
        kMaxXNodes, [&](const std::string& xnode, const Reader& variants) {
          variants.each_member(kMaxVariants, [&](const std::string& variant, const Reader& on) {
            on.each_member(kMaxXpus, [&](const std::string& type, const Reader& us) {
              s.variant_wcet_us[xnode][variant][type] = us.integer(1, kMaxTimeUs);
            });
          });
        });
  return s;
}

std::vector<Scenario> read_scenarios(const Reader& root) {
  std::vector<Scenario> all;
  root["scenarios"].each_element(
      kMaxScenarios, [&](std::size_t, const Reader& x) { all.push_back(read_scenario(x)); });
  return all;
}

ordered_json scenarios_to_json(const std::vector<Scenario>& scenarios) {
  ordered_json all = ordered_json::array();
  for (const Scenario& s : scenarios) {
    ordered_json one = {{"name", s.name}};
    if (!s.wcet_scale_pct.empty()) one["wcet_scale_pct"] = s.wcet_scale_pct;
    if (!s.wcet_us.empty()) one["wcet_us"] = s.wcet_us;
    if (!s.lost.empty()) one["lost"] = s.lost;
    if (!s.when.empty()) one["when"] = ordered_json::array();
    for (const Condition& c : s.when) {
      ordered_json condition = {{"file", c.file}};
      if (c.at_least) condition["at_least"] = *c.at_least;
      if (c.at_most) condition["at_most"] = *c.at_most;
      if (c.equals) condition["equals"] = *c.equals;
      one["when"].push_back(std::move(condition));
    }
    if (s.degraded) one["degraded"] = true;
    if (!s.variant_wcet_us.empty()) one["variant_wcet_us"] = s.variant_wcet_us;
    all.push_back(std::move(one));
  }
  return all;
}

/// {"variants": {"fcd.infer": "small"}, "off": ["lane"]}
void read_loss(const Reader& x, const AppSpec& app, const NameIndex& index, Loss& loss) {
  if (x.has("variants"))
    x["variants"].each_member(kMaxXNodes, [&](const std::string& xnode, const Reader& name) {
      const auto found = index.find(xnode);
      if (found == index.end()) return name.refuse("the app has no XNode '" + xnode + "'");
      const auto i = static_cast<std::size_t>(found->second);
      const std::string variant = name.text();
      const int is = app.xnodes[i].find_variant(variant);
      if (is < 0) return name.refuse("XNode '" + xnode + "' has no variant '" + variant + "'");
      loss.variant.resize(app.xnodes.size(), -1);
      loss.variant[i] = is;
    });
  if (x.has("off")) {
    x["off"].each_element(
        kMaxXNodes, [&](std::size_t, const Reader& name) { loss.off.push_back(name.text()); });
    std::sort(loss.off.begin(), loss.off.end());
  }
}

ordered_json variants_to_json(const Loss& loss, const AppSpec& app) {
  ordered_json variants = ordered_json::object();
  for (std::size_t i = 0; i < loss.variant.size(); ++i)
    if (const int variant = loss.variant[i]; variant >= 0)
      variants[app.xnodes[i].name] = app.xnodes[i].variants[static_cast<std::size_t>(variant)].name;
  return variants;
}

Handover read_handover(const Reader& x, const AppSpec& app, const NameIndex& table_of) {
  Handover handover{read_name(x["from"], table_of, "table", "the file"),
                    read_name(x["to"], table_of, "table", "the file"),
                    std::vector<std::optional<std::int64_t>>(app.chains.size())};
  handover.settles_us = x["settles_us"].time();
  if (x.has("not_claimed"))
    x["not_claimed"].each_element(kMaxXNodes, [&](std::size_t, const Reader& why) {
      handover.not_claimed.push_back(why.text());
    });
  each_chain(x, app, [&](std::size_t k, const Reader& c) {
    if (c.has("off") && c["off"].boolean()) {
      handover.worst_case_us[k] = kNotThere;
      if (c.has("worst_case_us")) c["worst_case_us"].refuse("has none: it is off");
    } else if (c.has("worst_case_us")) {
      handover.worst_case_us[k] = c["worst_case_us"].time();
    }
  });
  return handover;
}

Table read_table(const Reader& x, const AppSpec& app, const Platform& platform,
                 const NameIndex& index) {
  Table table;
  table.keys.placements.resize(app.xnodes.size());
  table.name = x["name"].text();
  read_loss(x, app, index, table.loss);
  std::vector<char> placed_already(app.xnodes.size(), 0);
  x["xnodes"].each_element(kMaxXNodes, [&](std::size_t, const Reader& placed) {
    const int found = read_name(placed["name"], index, "XNode", "the app");
    if (placed.failed()) return;
    const auto i = static_cast<std::size_t>(found);
    // What is off has keys all the same: the certificate counts with them.
    const bool off = table.loss.is_off(app.xnodes[i].module);
    if (off && placed.has("xpu"))
      return placed["xpu"].refuse("the module of XNode '" + app.xnodes[i].name + "' is off");
    const std::string id = off ? "" : placed["xpu"].text();
    Placement by_keys{platform.find(id)};
    by_keys.key_us = read_series(placed, "key_us", true);
    by_keys.hold_us = read_series(placed, "hold_us", false);
    if (placed.failed()) return;
    if (std::exchange(placed_already[i], 1) != 0)
      return placed["name"].refuse("XNode '" + app.xnodes[i].name + "' is placed twice");
    if (by_keys.xpu < 0 && !off)
      placed["xpu"].refuse("XPU '" + id + "' is not in platform '" + platform.name + "'");
    table.keys.placements[i] = std::move(by_keys);
  });
  for (std::size_t i = 0; i < app.xnodes.size() && !x.failed(); ++i)
    if (table.keys.placements[i].key_us.empty())
      x["xnodes"].refuse("XNode '" + app.xnodes[i].name + "' " +
                         (placed_already[i] == 0 ? "is not placed" : "has no key"));
  for (const ChainSpec& chain : app.chains) table.keys.chains.push_back({chain.name, kNotThere});
  std::vector<char> kept(app.chains.size(), 0);
  for (const int k : kept_chains(app, table.loss)) kept[static_cast<std::size_t>(k)] = 1;
  each_chain(
      x, app,
      [&](std::size_t k, const Reader& c) {
        table.keys.chains[k] = {app.chains[k].name, c["worst_case_us"].time(), 0, false};
        if (c.has("urgent_worst_case_us"))
          table.keys.chains[k].urgent_worst_case_us = c["urgent_worst_case_us"].time();
      },
      std::move(kept));
  if (x.has("order")) table.keys.order = read_pairs(x["order"], index);
  return table;
}

/// By `table`, which is number `t`.
Served read_served(const Reader& x, const AppSpec& app, int t, const Table& table) {
  Served served{t, worst_cases(table.keys)};
  served.chain_bound_us.assign(app.chains.size(), kNotThere);
  if (x.has("lower_bound_us")) served.lower_bound_us = x["lower_bound_us"].time();
  each_chain(
      x, app,
      [&](std::size_t k, const Reader& c) {
        if (c.has("worst_case_us")) served.chain_worst_us[k] = c["worst_case_us"].time();
        served.chain_bound_us[k] = c["lower_bound_us"].time();
      },
      chains_of(table.keys));
  return served;
}

}  // namespace

Result<Scenarios> parse_scenarios(std::string_view text, std::string_view origin,
                                  const AppSpec& app, const Platform& platform, Keys* keys) {
  XAUTO_ASSIGN(const nlohmann::json document, json_document::parse(text, origin));
  Reader::Context context{std::string(origin), {}};
  const Reader root(context, &document, "");
  root.expect("xauto.scenarios");
  Scenarios scenarios;
  scenarios.app = root["app"].text();
  scenarios.list = read_scenarios(root);
  XAUTO_TRY(context.status());
  XAUTO_TRY(in_file(validate(scenarios, app, platform), origin));
  if (keys != nullptr) *keys = context.keys(document);
  return scenarios;
}

Result<Tables> parse_tables(std::string_view text, std::string_view origin, const AppSpec& app,
                            const Platform& platform, Keys* keys) {
  XAUTO_ASSIGN(const nlohmann::json document, json_document::parse(text, origin));
  Reader::Context context{std::string(origin), {}};
  const Reader root(context, &document, "");
  root.expect("xauto.tables", kAppVersion, "solve again");
  XAUTO_TRY(context.status());
  Tables tables;
  tables.app = root["app"].text();
  tables.app_hash = root["app_hash"].text();
  if (root.has("platform")) tables.platform = root["platform"].text();
  tables.scenarios = read_scenarios(root);
  const NameIndex xnodes = index_by_name(app.xnodes);
  root["tables"].each_element(kMaxTables, [&](std::size_t, const Reader& x) {
    tables.tables.push_back(read_table(x, app, platform, xnodes));
  });
  XAUTO_TRY(context.status());

  const NameIndex scenario_of = index_by_name(tables.scenarios),
                  table_of = index_by_name(tables.tables);
  tables.serves.resize(tables.scenarios.size());
  root["serves"].each_element(kMaxScenarios, [&](std::size_t, const Reader& x) {
    const int s = read_name(x["scenario"], scenario_of, "scenario", "the file");
    const int t = read_name(x["table"], table_of, "table", "the file");
    if (s < 0 || t < 0) return;
    Served served = read_served(x, app, t, tables.tables[static_cast<std::size_t>(t)]);
    if (x.failed()) return;
    Served& of = tables.serves[static_cast<std::size_t>(s)];
    if (of.table >= 0) return x["scenario"].refuse("is served twice");
    of = std::move(served);
  });
  tables.notice_us = root["notice_us"].time();
  if (root.has("handovers"))
    root["handovers"].each_element(kMaxTables * kMaxTables, [&](std::size_t, const Reader& x) {
      tables.handovers.push_back(read_handover(x, app, table_of));
    });
  if (root.has("solve_us")) tables.solve_us = root["solve_us"].integer(0, kMaxTimeUs);
  XAUTO_TRY(context.status());
  for (std::size_t s = 0; s < tables.serves.size(); ++s)
    if (tables.serves[s].table < 0)
      return fail(ErrorCode::kInvalid,
                  "scenario '" + tables.scenarios[s].name + "' is served by no table",
                  std::string(origin) + ": /serves");
  XAUTO_TRY(in_file(validate(tables, app, platform), origin));
  set_figures(tables, app);
  if (keys != nullptr) *keys = context.keys(document);
  return tables;
}

std::string to_json(const Scenarios& scenarios) {
  ordered_json document = {{"schema", "xauto.scenarios"}, {"version", 1}, {"app", scenarios.app}};
  document["scenarios"] = scenarios_to_json(scenarios.list);
  return json_document::to_text(document);
}

namespace {

void put_keys(const Placement& keys, ordered_json& into) {
  into["key_us"] = keys.key_us;
  if (!keys.hold_us.empty()) into["hold_us"] = keys.hold_us;
}

ordered_json claims_to_json(const std::vector<ChainClaim>& claims) {
  ordered_json chains = ordered_json::array();
  for (const ChainClaim& c : claims) {
    if (c.worst_case_us == kNotThere) continue;
    chains.push_back({{"name", c.name}, {"worst_case_us", c.worst_case_us}});
    if (c.urgent_worst_case_us) chains.back()["urgent_worst_case_us"] = *c.urgent_worst_case_us;
  }
  return chains;
}

ordered_json handover_to_json(const Handover& h, const Tables& tables, const AppSpec& app) {
  ordered_json one = {{"from", tables.tables[static_cast<std::size_t>(h.from)].name},
                      {"to", tables.tables[static_cast<std::size_t>(h.to)].name},
                      {"settles_us", h.settles_us}};
  if (!h.not_claimed.empty()) one["not_claimed"] = h.not_claimed;
  one["chains"] = ordered_json::array();
  for (std::size_t c = 0; c < app.chains.size(); ++c) {
    one["chains"].push_back({{"name", app.chains[c].name}});
    if (h.worst_case_us[c] == kNotThere)
      one["chains"].back()["off"] = true;
    else if (h.worst_case_us[c])
      one["chains"].back()["worst_case_us"] = *h.worst_case_us[c];
  }
  return one;
}

}  // namespace

std::string to_json(const Tables& tables, const AppSpec& app, const Platform& platform) {
  const auto name = [&](int i) { return app.xnodes[static_cast<std::size_t>(i)].name; };
  ordered_json document = {{"schema", "xauto.tables"},
                           {"version", kAppVersion},
                           {"app", tables.app},
                           {"app_hash", tables.app_hash},
                           {"platform", tables.platform}};
  document["scenarios"] = scenarios_to_json(tables.scenarios);
  document["tables"] = ordered_json::array();
  for (const Table& t : tables.tables) {
    ordered_json xnodes = ordered_json::array();
    for (std::size_t i = 0; i < app.xnodes.size(); ++i) {
      ordered_json placed = {{"name", app.xnodes[i].name}};
      if (t.xpu(i) >= 0) placed["xpu"] = platform.xpus[static_cast<std::size_t>(t.xpu(i))].id;
      put_keys(t.keys.placements[i], placed);
      xnodes.push_back(std::move(placed));
    }
    ordered_json table = {{"name", t.name}};
    table["xnodes"] = std::move(xnodes);
    table["chains"] = claims_to_json(t.keys.chains);
    if (!t.keys.order.empty()) table["order"] = pairs_to_json(t.keys.order, name);
    if (ordered_json variants = variants_to_json(t.loss, app); !variants.empty())
      table["variants"] = std::move(variants);
    if (!t.loss.off.empty()) table["off"] = t.loss.off;
    document["tables"].push_back(std::move(table));
  }
  document["serves"] = ordered_json::array();
  for (std::size_t s = 0; s < tables.serves.size(); ++s) {
    const Served& served = tables.serves[s];
    const Table& table = tables.tables[static_cast<std::size_t>(served.table)];
    ordered_json one = {{"scenario", tables.scenarios[s].name}, {"table", table.name}};
    if (served.lower_bound_us > bound_of_chains(served, app))
      one["lower_bound_us"] = served.lower_bound_us;
    one["chains"] = ordered_json::array();
    for (std::size_t c = 0; c < app.chains.size(); ++c) {
      if (served.chain_bound_us[c] == kNotThere) continue;
      ordered_json chain = {{"name", app.chains[c].name}};
      if (served.chain_worst_us[c] < table.keys.chains[c].worst_case_us)
        chain["worst_case_us"] = served.chain_worst_us[c];
      chain["lower_bound_us"] = served.chain_bound_us[c];
      one["chains"].push_back(std::move(chain));
    }
    document["serves"].push_back(std::move(one));
  }
  document["notice_us"] = tables.notice_us;
  if (!tables.handovers.empty()) document["handovers"] = ordered_json::array();
  for (const Handover& h : tables.handovers)
    document["handovers"].push_back(handover_to_json(h, tables, app));
  document["solve_us"] = tables.solve_us;
  return json_document::to_text(document);
}

Result<Scenarios> load_scenarios(const std::string& path, const AppSpec& app,
                                 const Platform& platform) {
  XAUTO_ASSIGN(const std::string text, read_file(path));
  Keys keys;
  XAUTO_ASSIGN(Scenarios scenarios, parse_scenarios(text, path, app, platform, &keys));
  XAUTO_TRY(judge(keys, path));
  return scenarios;
}

Result<Tables> load_tables(const std::string& path, const AppSpec& app, const Platform& platform) {
  XAUTO_ASSIGN(const std::string text, read_file(path));
  Keys keys;
  XAUTO_ASSIGN(Tables tables, parse_tables(text, path, app, platform, &keys));
  XAUTO_TRY(judge(keys, path));
  return tables;
}

bool says_tables(std::string_view text) {
  const auto document = Json::parse(text);
  return document && document->at("schema").text() == std::optional<std::string>("xauto.tables");
}

bool is_tables_file(const std::string& path) {
  const auto text = read_file(path);
  return text && says_tables(*text);
}

}  // namespace xauto
