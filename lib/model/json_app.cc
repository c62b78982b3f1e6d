// SPDX-License-Identifier: Apache-2.0
// app.json
#include <optional>
#include <set>
#include <unordered_set>

#include "model/components.h"
#include "model/json.h"
#include "model/json_parts.h"
#include "model/periodic.h"

namespace xauto {

using namespace json_parts;

namespace {

std::map<std::string, std::int64_t, std::less<>> read_wcets(const Reader& reader) {
  std::map<std::string, std::int64_t, std::less<>> wcets;
  reader.each_member(kMaxXpus, [&](const std::string& type, const Reader& us) {
    wcets[type] = us.integer(1, kMaxTimeUs);
  });
  return wcets;
}

/// Of the types that are in wcet_us.
template <class Implemented>
void read_memory(const Reader& x, Implemented& into) {
  if (!x.has("memory_kb")) return;
  x["memory_kb"].each_member(kMaxXpus, [&](const std::string& type, const Reader& kb) {
    const std::int64_t value = kb.integer(0, kMaxMemoryKb);
    if (!kb.failed() && !into.wcet_us.contains(type))
      return kb.refuse("'" + type + "' is no key of wcet_us");
    into.memory_kb[type] = value;
  });
}

/// Of the types that are in wcet_us, and no longer than that.
template <class Implemented>
void read_typical(const Reader& x, Implemented& into) {
  if (!x.has("typical_us")) return;
  x["typical_us"].each_member(kMaxXpus, [&](const std::string& type, const Reader& us) {
    const std::int64_t value = us.integer(1, kMaxTimeUs);
    if (us.failed()) return;
    const auto wcet = into.wcet_us.find(type);
    if (wcet == into.wcet_us.end()) return us.refuse("'" + type + "' is no key of wcet_us");
    if (value > wcet->second)
      return us.refuse(std::to_string(value) + " us is above the WCET there, " +
                       std::to_string(wcet->second) + " us");
    into.typical_us[type] = value;
  });
}

void read_beside(const Reader& x, XNodeSpec& into) {
  if (!x.has("beside")) return;
  x["beside"].each_element(kMaxBeside, [&](std::size_t, const Reader& b) {
    BesideSpec beside{b["on"].text()};
    b["load"].each_member(kMaxXpus, [&](const std::string& type, const Reader& xpus) {
      beside.load[type] = xpus.integer(1, static_cast<std::int64_t>(kMaxXpus));
    });
    beside.wcet_us = b["wcet_us"].integer(1, kMaxTimeUs);
    into.beside.push_back(std::move(beside));
  });
}

void read_xnodes(const Reader& root, const NameIndex& sources, AppSpec& app) {
  root["xnodes"].each_element(kMaxXNodes, [&](std::size_t, const Reader& x) {
    XNodeSpec spec{x["name"].text(), x["module"].text(), {}};
    spec.wcet_us = read_wcets(x["wcet_us"]);
    read_memory(x, spec);
    read_typical(x, spec);
    read_beside(x, spec);
    if (x.has("message_bytes"))
      spec.message_bytes = x["message_bytes"].integer(1, kMaxMessageBytes);
    spec.sources = read_heard(x, sources);
    if (x.has("real_on"))
      x["real_on"].each_element(kMaxXpus, [&](std::size_t, const Reader& type) {
        const std::string name = type.text();
        if (!type.failed() && !spec.wcet_us.contains(name))
          return type.refuse("'" + name + "' is no key of wcet_us");
        spec.real_on.insert(name);
      });
    if (x.has("variants"))
      x["variants"].each_element(kMaxVariants, [&](std::size_t, const Reader& v) {
        VariantSpec variant{v["name"].text()};
        if (v.has("quality_pct")) variant.quality_pct = v["quality_pct"].integer(1, 100);
        variant.wcet_us = read_wcets(v["wcet_us"]);
        read_memory(v, variant);
        read_typical(v, variant);
        spec.variants.push_back(std::move(variant));
      });
    app.xnodes.push_back(std::move(spec));
  });
}

/// Clocks are those of "clocks" and those that sources name; "main" is the first. What is listed
/// twice is refused here: validate() counts them as the app does.
void read_clocks_and_sources(const Reader& root, AppSpec& app,
                             std::vector<Keys::Undeclared>& undeclared) {
  NameIndex index;
  if (root.has("clocks"))
    root["clocks"].each_element(kMaxSources, [&](std::size_t, const Reader& clock) {
      ClockSpec spec{clock["name"].text()};
      const bool main = spec.name == kMainClock;
      spec.ppm = main ? 0 : kDefaultPpm;
      if (clock.has("ppm")) spec.ppm = clock["ppm"].integer(0, kMaxPpm);
      if (clock.failed()) return;
      if (spec.name.empty()) return clock["name"].refuse("a clock needs a name");
      if (!index.try_emplace(spec.name, main ? 0 : static_cast<int>(app.clocks.size())).second)
        return clock["name"].refuse("two clocks are called '" + spec.name + "'");
      if (main)
        app.clocks.front() = std::move(spec);
      else
        app.clocks.push_back(std::move(spec));
    });
  index.try_emplace(kMainClock, 0);
  std::string declared;
  for (const ClockSpec& clock : app.clocks)
    if (declared.size() < kMaxNameBytes) declared += (declared.empty() ? "" : ", ") + clock.name;
  root.knows({"sources/*/urgent/by_us", "sources/*/urgent/every_us", "sources/*/urgent/marked_by"});
  std::optional<std::size_t> without;  // the first that has no rate
  root["sources"].each_element(kMaxSources, [&](std::size_t i, const Reader& s) {
    const bool rate = s.has("rate_hz") || s.has("period_us");
    if (!rate && !without) without = i;
    SourceSpec source{s["name"].text(), rate ? read_period(s) : kNoRate};
    if (s.has("offset_us")) source.offset_us = s["offset_us"].time();
    if (s.has("jitter_us")) source.jitter_us = s["jitter_us"].integer(0, kMaxPeriodUs);
    if (s.has("urgent")) {
      const Reader urgent = s["urgent"];
      source.urgent = {urgent["by_us"].integer(1, kMaxPeriodUs),
                       urgent["every_us"].integer(1, kMaxPeriodUs),
                       urgent.has("marked_by") ? urgent["marked_by"].text() : std::string()};
    }
    if (s.has("clock")) {
      const std::string name = s["clock"].text();
      if (s.failed()) return;
      if (name.empty()) return s["clock"].refuse("a clock needs a name");
      const auto [clock, added] = index.try_emplace(name, static_cast<int>(app.clocks.size()));
      if (added) {
        app.clocks.push_back({name, kDefaultPpm});
        undeclared.push_back({"/sources/" + std::to_string(i) + "/clock",
                              "clock '" + name + "' is not in \"clocks\" (known: " + declared +
                                  "): taken as a clock of its own, off by at most " +
                                  std::to_string(kDefaultPpm) + " ppm"});
      }
      source.clock = clock->second;
    }
    app.one_at_a_time = !rate;
    if (without && (rate || *without != 0)) {
      const SourceSpec& other = app.sources[rate ? *without : 0];
      return s.refuse(
          "has " + std::string(rate ? "a rate" : "neither \"period_us\" nor \"rate_hz\"") +
              ", and source '" + other.name + "' has " + (rate ? "none" : "a rate"),
          "give every source a rate, or none: then they release together, and again when "
          "all of that has ended");
    }
    app.sources.push_back(std::move(source));
  });
}

/// Behind the XNodes, since modules are put into their order, and validate() then counts anew.
void read_modules(const Reader& root, AppSpec& app) {
  std::unordered_set<std::string_view> named, listed;
  for (const XNodeSpec& x : app.xnodes) named.insert(x.module);
  if (root.has("modules"))
    root["modules"].each_element(kMaxXNodes, [&](std::size_t, const Reader& m) {
      ModuleSpec module{m["name"].text()};
      if (m.has("max_in_flight"))
        module.max_in_flight = m["max_in_flight"].integer(1, kMaxInFlight);
      if (m.has("optional")) module.optional = m["optional"].boolean();
      if (m.has("host")) module.host = m["host"].text();
      if (m.failed()) return;
      const auto found = named.find(module.name);
      if (found == named.end())
        return m["name"].refuse("no XNode is in module '" + module.name + "'");
      if (!listed.insert(*found).second)
        return m["name"].refuse("two modules are called '" + module.name + "'");
      app.modules.push_back(std::move(module));
    });
  complete_modules(app);
}

/// ["u", "v"], or {"from": "u", "to": "v", "transfer_us": {"gpu": {"dla": 300}}}.
void read_edges(const Reader& root, const NameIndex& xnodes, AppSpec& app) {
  root["edges"].each_element(kMaxEdges, [&](std::size_t e, const Reader& edge) {
    if (!edge.is_object()) return app.edges.push_back(read_pair(edge, xnodes));
    app.edges.emplace_back(read_name(edge["from"], xnodes, "XNode", "the app"),
                           read_name(edge["to"], xnodes, "XNode", "the app"));
    if (edge.has("transfer_us"))
      edge["transfer_us"].each_member(kMaxXpus, [&](const std::string& from, const Reader& row) {
        row.each_member(kMaxXpus, [&](const std::string& to, const Reader& us) {
          app.transfers.push_back({static_cast<int>(e), from, to, us.time()});
        });
      });
  });
}

/// "*": every source, and every XNode of ends_of() that hears of it. Such an entry has no name, and is of the chains that no
/// other one says. Returns [chain] which line of the file says it.
std::vector<std::size_t> read_chains(const Reader& root, const NameIndex& sources,
                                     const NameIndex& xnodes, AppSpec& app) {
  struct Every {
    ChainSpec chain;
    Reader at;
    std::size_t line;
  };
  std::vector<Every> all;
  std::vector<std::size_t> line_of;
  if (!root.has("chains")) return line_of;
  root["chains"].each_element(kMaxAppChains, [&](std::size_t line, const Reader& c) {
    const bool any_from = c["from"].text() == kEveryEnd, any_to = c["to"].text() == kEveryEnd;
    ChainSpec chain{any_from || any_to ? std::string() : c["name"].text()};
    if ((any_from || any_to) && c.has("name"))
      return c["name"].refuse("is one name for the several chains that a \"*\" stands for",
                              "leave it out: they are called after their ends");
    if (!any_from) chain.from = read_name(c["from"], sources, "source", "\"sources\"");
    if (!any_to) chain.to = read_name(c["to"], xnodes, "XNode", "the app");
    if (c.has("deadline_us")) chain.deadline_us = c["deadline_us"].integer(1, kMaxTimeUs);
    if (c.has("weight")) chain.weight = c["weight"].integer(0, kMaxWeight);
    if (any_from || any_to) {
      all.push_back({std::move(chain), c, line});
      return;
    }
    app.chains.push_back(std::move(chain));
    line_of.push_back(line);
  });
  if (all.empty()) return line_of;
  std::set<std::pair<int, int>> said;
  for (const ChainSpec& chain : app.chains) said.insert({chain.from, chain.to});
  const std::vector<ChainSpec> possible = default_chains(app);
  for (const auto& [entry, at, line] : all) {
    bool any = false;
    for (const ChainSpec& one : possible) {
      if ((entry.from >= 0 && entry.from != one.from) || (entry.to >= 0 && entry.to != one.to))
        continue;
      any = true;
      if (!said.insert({one.from, one.to}).second) continue;
      app.chains.push_back(one);
      app.chains.back().deadline_us = entry.deadline_us;
      app.chains.back().weight = entry.weight;
      line_of.push_back(line);
    }
    if (!any && !possible.empty())  // of an app without chains validate() says why
      at.refuse(
          "stands for no chain of the app",
          "\"*\" is every source, or every XNode that nobody hears of; a chain is between a source "
          "and an XNode that hears of it");
  }
  return line_of;
}

// ---- writing ------------------------------------------------------------------------------------

ordered_json clocks_to_json(const AppSpec& app) {
  ordered_json out = ordered_json::array();
  for (const ClockSpec& clock : app.clocks)
    if (clock != ClockSpec{kMainClock, 0})
      out.push_back({{"name", clock.name}, {"ppm", clock.ppm}});
  return out;
}

ordered_json sources_to_json(const AppSpec& app) {
  ordered_json out = ordered_json::array();
  for (const SourceSpec& s : app.sources) {
    ordered_json source = {{"name", s.name}};
    if (!app.one_at_a_time) write_period(s.period, source);
    if (s.offset_us != 0) source["offset_us"] = s.offset_us;
    if (s.jitter_us != 0) source["jitter_us"] = s.jitter_us;
    if (s.clock != 0) source["clock"] = app.clocks[static_cast<std::size_t>(s.clock)].name;
    if (s.urgent) {
      source["urgent"] = {{"by_us", s.urgent->by_us}, {"every_us", s.urgent->every_us}};
      if (!s.urgent->marked_by.empty()) source["urgent"]["marked_by"] = s.urgent->marked_by;
    }
    out.push_back(std::move(source));
  }
  return out;
}

ordered_json edges_to_json(const AppSpec& app) {
  const auto name = [&](int i) { return app.xnodes[static_cast<std::size_t>(i)].name; };
  std::vector<ordered_json> transfer(app.edges.size());
  for (const TransferSpec& t : app.transfers)
    transfer[static_cast<std::size_t>(t.edge)][t.from_type][t.to_type] = t.transfer_us;
  ordered_json out = ordered_json::array();
  for (std::size_t e = 0; e < app.edges.size(); ++e) {
    const auto [u, v] = app.edges[e];
    if (transfer[e].is_null())
      out.push_back({name(u), name(v)});
    else
      out.push_back({{"from", name(u)}, {"to", name(v)}, {"transfer_us", std::move(transfer[e])}});
  }
  return out;
}

ordered_json xnodes_to_json(const AppSpec& app) {
  ordered_json xnodes = ordered_json::array();
  for (const XNodeSpec& x : app.xnodes) {
    ordered_json xnode = {{"name", x.name}, {"module", x.module}};
    write_heard(x.sources, app.sources, xnode);
    xnode["wcet_us"] = ordered_json(x.wcet_us);
    for (const BesideSpec& b : x.beside)
      xnode["beside"].push_back(
          {{"on", b.on}, {"load", ordered_json(b.load)}, {"wcet_us", b.wcet_us}});
    if (!x.typical_us.empty()) xnode["typical_us"] = ordered_json(x.typical_us);
    if (!x.real_on.empty()) xnode["real_on"] = x.real_on;
    if (!x.memory_kb.empty()) xnode["memory_kb"] = ordered_json(x.memory_kb);
    if (x.message_bytes > 0) xnode["message_bytes"] = x.message_bytes;
    for (const VariantSpec& v : x.variants) {
      ordered_json variant = {
          {"name", v.name}, {"quality_pct", v.quality_pct}, {"wcet_us", ordered_json(v.wcet_us)}};
      if (!v.typical_us.empty()) variant["typical_us"] = ordered_json(v.typical_us);
      if (!v.memory_kb.empty()) variant["memory_kb"] = ordered_json(v.memory_kb);
      xnode["variants"].push_back(std::move(variant));
    }
    xnodes.push_back(std::move(xnode));
  }
  return xnodes;
}

void write_chains(const AppSpec& app, ordered_json& document) {
  const auto name = [&](int i) { return app.xnodes[static_cast<std::size_t>(i)].name; };
  if (!app.samples.empty()) document["samples"] = pairs_to_json(app.samples, name);
  for (const ChainSpec& c : app.chains) {
    ordered_json chain = {{"name", c.name},
                          {"from", app.sources[static_cast<std::size_t>(c.from)].name},
                          {"to", name(c.to)}};
    if (c.deadline_us) chain["deadline_us"] = *c.deadline_us;
    if (c.weight != 1) chain["weight"] = c.weight;
    document["chains"].push_back(std::move(chain));
  }
}

}  // namespace

Result<AppSpec> parse_app(std::string_view text, std::string_view origin, Keys* keys) {
  XAUTO_ASSIGN(const nlohmann::json document, json_document::parse(text, origin));
  Reader::Context context{std::string(origin), {}};
  const Reader root(context, &document, "");
  AppSpec app;
  root.expect(
      "xauto.app", kAppVersion,
      "`xauto profile --app-out` writes it anew; by hand: it names its sources, and each XNode "
      "that waits for nobody names the \"source\" that it hears of");
  // What is asked of the solver; tools/xauto/objectives_file.h reads it.
  root.knows({"pins/*/xnode", "pins/*/xpu", "forbids/*/xnode", "forbids/*/xpu", "groups"});
  // What `xauto import` knows beside it: imported.h.
  root.knows({"todo/*/at",
              "todo/*/what",
              "seen/from",
              "seen/duration_us",
              "seen/cores",
              "seen/executors/*/name",
              "seen/executors/*/type",
              "seen/executors/*/threads",
              "seen/executors/*/groups/*/type",
              "seen/executors/*/groups/*/xnodes",
              "seen/xnodes/*/name",
              "seen/xnodes/*/times_us",
              "seen/xnodes/*/delay_us",
              "seen/xnodes/*/lead_us",
              "seen/xnodes/*/depth",
              "seen/chains/*/name",
              "seen/chains/*/count",
              "seen/chains/*/p50_us",
              "seen/chains/*/p99_us",
              "seen/chains/*/max_us"});
  app.name = root["name"].text();
  if (root.has("incomplete")) app.incomplete = root["incomplete"].text();
  std::vector<Keys::Undeclared> undeclared;
  read_clocks_and_sources(root, app, undeclared);
  const NameIndex sources = index_by_name(app.sources);
  read_xnodes(root, sources, app);
  read_modules(root, app);
  XAUTO_TRY(context.status());
  // Before any of them is looked up by name.
  XAUTO_TRY(in_file(validate(app.sources), origin));
  XAUTO_TRY(in_file(validate_xnodes(app), origin));
  const NameIndex xnodes = index_by_name(app.xnodes);
  if (root.has("deadline_us")) app.deadline_us = root["deadline_us"].integer(1, kMaxTimeUs);
  read_edges(root, xnodes, app);
  if (root.has("samples")) app.samples = read_pairs(root["samples"], xnodes, kMaxSamples);
  XAUTO_TRY(context.status());  // chains of "*" follow what is there
  const std::vector<std::size_t> line_of = read_chains(root, sources, xnodes, app);
  XAUTO_TRY(context.status());
  complete_chains(app);
  give_deadlines(app);
  Status valid = validate(app);
  if (!valid) valid = in_file_order(std::move(valid).error(), "chains", line_of);
  XAUTO_TRY(in_file(std::move(valid), origin));
  if (keys != nullptr) {
    *keys = context.keys(document);
    keys->undeclared = std::move(undeclared);
  }
  return app;
}

std::string to_json(const AppSpec& app) {
  ordered_json document = {{"schema", "xauto.app"}, {"version", kAppVersion}, {"name", app.name}};
  if (!app.incomplete.empty()) document["incomplete"] = app.incomplete;
  if (ordered_json clocks = clocks_to_json(app); !clocks.empty())
    document["clocks"] = std::move(clocks);
  document["sources"] = sources_to_json(app);
  for (const ModuleSpec& m : app.modules) {
    document["modules"].push_back(
        {{"name", m.name}, {"max_in_flight", m.max_in_flight}, {"optional", m.optional}});
    if (!m.host.empty()) document["modules"].back()["host"] = m.host;
  }
  document["xnodes"] = xnodes_to_json(app);
  document["edges"] = edges_to_json(app);
  if (app.deadline_us) document["deadline_us"] = *app.deadline_us;
  write_chains(app, document);
  return json_document::to_text(document);
}

}  // namespace xauto
