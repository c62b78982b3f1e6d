// SPDX-License-Identifier: Apache-2.0
#include "model/deployment.h"

#include <algorithm>
#include <charconv>
#include <set>

#include <nlohmann/json.hpp>

#include "model/json.h"
#include "model/json_document.h"

namespace xauto {
namespace {

using json_document::Reader;
using nlohmann::ordered_json;

constexpr std::int64_t kMaxRestarts = 1'000'000;
constexpr std::int64_t kMaxQueue = 256;
constexpr const char* kOnHangNames[] = {"log", "drop", "restart"};
constexpr const char* kOut = "cyclonedds";
constexpr const char* kFeed = "cyclonedds:feed";
constexpr const char* kReliabilityNames[] = {"reliable", "best_effort"};
constexpr const char* kDurabilityNames[] = {"volatile", "transient_local"};
constexpr const char* kProfileNames[] = {"default", "sensor_data"};

ModuleDeployment read_module(const Reader& r) {
  ModuleDeployment m;
  const auto integer = [&](const char* key, std::int64_t low, std::int64_t high) {
    return r.has(key) ? std::optional(r[key].integer(low, high)) : std::nullopt;
  };
  if (r.has("isolate")) m.isolate = r["isolate"].boolean();
  if (r.has("process")) {
    m.process = r["process"].text();
    if (m.process->empty()) r["process"].refuse("must not be empty");
    if (m.isolate) r["process"].refuse("excludes \"isolate\"", "one of the two is enough");
  }
  m.restarts = integer("restarts", 0, kMaxRestarts);
  if (r.has("overload")) {
    const auto overload = Overload::parse(r["overload"].text());
    if (overload)
      m.overload = *overload;
    else
      r["overload"].refuse(overload.error().what, overload.error().hint);
  }
  m.budget_pct = integer("budget_pct", 1, kMaxBudgetPct);
  m.hang_pct = integer("hang_pct", 1, kMaxBudgetPct);
  m.hang_us = integer("hang_us", 1, kMaxTimeUs);
  if (m.hang_pct && m.hang_us)
    r["hang_us"].refuse("excludes \"hang_pct\"", "one of the two is enough");
  if (r.has("on_hang")) {
    const std::string text = r["on_hang"].text();
    for (std::size_t i = 0; i < std::size(kOnHangNames); ++i)
      if (text == kOnHangNames[i]) m.on_hang = static_cast<OnHang>(i);
    if (!m.on_hang) r["on_hang"].refuse("must be \"log\", \"drop\" or \"restart\"");
  }
  m.match_us = integer("match_us", 0, kMaxTimeUs);
  if (r.has("remap"))
    r["remap"].each_member(kMaxRemaps, [&](const std::string& topic, const Reader& to) {
      std::string name = to.text();
      if (name.empty() && !to.failed()) to.refuse("must not be empty");
      m.remap.emplace(topic, std::move(name));
    });
  if (r.has("parameters"))
    r["parameters"].each_member(
        kMaxModuleParameters, [&](const std::string& name, const Reader& value) {
          if (name.empty() || name.size() > kMaxParameterName)
            return value.refuse("is of a parameter whose name has not 1 to " +
                                std::to_string(kMaxParameterName) + " bytes");
          m.parameters.emplace(name, value.scalar());
        });
  return m;
}

/// One of two words, by its place among `names`.
template <class Enum>
std::optional<Enum> one_of(const Reader& r, const char* key, const char* const (&names)[2]) {
  if (!r.has(key)) return std::nullopt;
  const std::string text = r[key].text();
  for (std::size_t i = 0; i < std::size(names); ++i)
    if (text == names[i]) return static_cast<Enum>(i);
  r[key].refuse(std::string("must be \"") + names[0] + "\" or \"" + names[1] + "\"");
  return std::nullopt;
}

TopicTransport read_transport(const Reader& r) {
  TopicTransport t;
  if (!r.is_object()) {
    const std::string where = r.text();
    t.feed = where == kFeed;
    if (!t.feed && where != kOut)
      r.refuse(std::string("must be \"") + kOut + "\" or \"" + kFeed + "\"");
    return t;
  }
  if (r["via"].text() != kOut) r["via"].refuse(std::string("must be \"") + kOut + "\"");
  if (r.has("feed")) t.feed = r["feed"].boolean();
  if (!r.has("qos")) return t;
  const Reader qos = r["qos"];
  if (!qos.is_object()) qos.refuse("must be an object");
  t.qos.profile = one_of<QosProfile>(qos, "profile", kProfileNames);
  t.qos.reliability = one_of<Reliability>(qos, "reliability", kReliabilityNames);
  t.qos.durability = one_of<Durability>(qos, "durability", kDurabilityNames);
  if (qos.has("depth")) {
    t.qos.depth = qos["depth"].integer(1, kMaxQosDepth);
    if (t.feed) qos["depth"].refuse("is of what goes out: of what is fed the newest message waits");
  }
  if (qos.has("deadline_us")) t.qos.deadline_us = qos["deadline_us"].integer(1, kMaxTimeUs);
  return t;
}

ordered_json to_document(const TopicTransport& t) {
  if (t.qos == TopicQos{}) return t.feed ? kFeed : kOut;
  ordered_json out = {{"via", kOut}};
  if (t.feed) out["feed"] = true;
  ordered_json qos = ordered_json::object();
  const auto word = [&](const char* key, const auto& value, const char* const(&names)[2]) {
    if (value) qos[key] = names[static_cast<std::size_t>(*value)];
  };
  word("profile", t.qos.profile, kProfileNames);
  word("reliability", t.qos.reliability, kReliabilityNames);
  word("durability", t.qos.durability, kDurabilityNames);
  if (t.qos.depth) qos["depth"] = *t.qos.depth;
  if (t.qos.deadline_us) qos["deadline_us"] = *t.qos.deadline_us;
  out["qos"] = std::move(qos);
  return out;
}

ordered_json to_document(const ModuleDeployment& m) {
  ordered_json out = ordered_json::object();
  const auto put = [&](const char* key, const auto& value) {
    if (value) out[key] = *value;
  };
  put("isolate", m.isolate);
  put("process", m.process);
  put("restarts", m.restarts);
  if (m.overload) out["overload"] = m.overload->to_string();
  put("budget_pct", m.budget_pct);
  put("hang_pct", m.hang_pct);
  put("hang_us", m.hang_us);
  if (m.on_hang) out["on_hang"] = to_string(*m.on_hang);
  put("match_us", m.match_us);
  if (!m.parameters.empty()) {
    ordered_json parameters = ordered_json::object();
    for (const auto& [name, value] : m.parameters)
      std::visit([&, at = &name](const auto& v) { parameters[*at] = v; }, value);
    out["parameters"] = std::move(parameters);
  }
  if (!m.remap.empty()) {
    ordered_json remap = ordered_json::object();
    for (const auto& [from, to] : m.remap) remap[from] = to;
    out["remap"] = std::move(remap);
  }
  return out;
}

/// What holds between keys of different places.
void check(const Deployment& d, const std::set<std::string>& modules, const Reader& root) {
  for (const std::string& name : modules) {
    const ModuleDeployment m = d.of(name);
    if (!m.on_hang) continue;
    const auto own = d.modules.find(name);
    const Reader at = own != d.modules.end() && own->second.on_hang
                          ? root["modules"][name.c_str()]["on_hang"]
                          : root["defaults"]["on_hang"];
    if (!m.hang_pct && !m.hang_us)
      at.refuse("XModule '" + name + "' has no hang limit", "add hang_pct or hang_us");
    else if (m.on_hang == OnHang::kRestart && !m.process && !m.isolate.value_or(false))
      at.refuse("XModule '" + name + "' has no process of its own to restart",
                "add \"isolate\": true, or use \"drop\"");
  }
}

}  // namespace

const char* to_string(OnHang action) {
  return kOnHangNames[static_cast<std::size_t>(action)];
}

Result<Overload> Overload::parse(const std::string& text) {
  if (text == "newest") return Overload{};
  if (text == "skip") return Overload{Kind::kSkip, 1};
  constexpr std::string_view kPrefix = "queue:";
  unsigned depth = 0;
  if (text.starts_with(kPrefix)) {
    const auto [end, error] =
        std::from_chars(text.data() + kPrefix.size(), text.data() + text.size(), depth);
    if (error == std::errc() && end == text.data() + text.size() && depth >= 1 && depth <= 256)
      return Overload{Kind::kQueue, depth};
  }
  return fail(ErrorCode::kInvalid, "overload policy '" + text + "'", {},
              "newest, skip, or queue:N with N from 1 to 256");
}

std::string Overload::to_string() const {
  switch (kind) {
    case Kind::kNewest:
      return "newest";
    case Kind::kSkip:
      return "skip";
    case Kind::kQueue:
      break;
  }
  return "queue:" + std::to_string(depth);
}

ModuleDeployment Deployment::of(std::string_view module) const {
  const auto own = modules.find(module);
  if (own == modules.end()) return defaults;
  ModuleDeployment m = own->second;
  const auto inherit = [&](auto ModuleDeployment::*key) {
    if (!(m.*key)) m.*key = defaults.*key;
  };
  // Of two keys that exclude each other, what is said of the module displaces both.
  if (!m.isolate && !m.process) {
    m.isolate = defaults.isolate;
    m.process = defaults.process;
  }
  if (!m.hang_pct && !m.hang_us) {
    m.hang_pct = defaults.hang_pct;
    m.hang_us = defaults.hang_us;
  }
  inherit(&ModuleDeployment::restarts);
  inherit(&ModuleDeployment::overload);
  inherit(&ModuleDeployment::budget_pct);
  inherit(&ModuleDeployment::on_hang);
  inherit(&ModuleDeployment::match_us);
  return m;
}

std::vector<std::vector<std::string>> Deployment::processes(const AppSpec& spec) const {
  std::vector<std::vector<std::string>> found;
  std::map<std::string, std::size_t> groups;
  std::set<std::string> seen;
  for (const XNodeSpec& xnode : spec.xnodes) {
    if (!seen.insert(xnode.module).second) continue;
    const ModuleDeployment m = of(xnode.module);
    if (m.process) {
      const auto [group, added] = groups.try_emplace(*m.process, found.size());
      if (added) found.emplace_back();
      found[group->second].push_back(xnode.module);
    } else if (m.isolate.value_or(false)) {
      found.push_back({xnode.module});
    }
  }
  return found;
}

namespace {

/// `app` null: names are not checked.
Result<Deployment> parse(std::string_view text, std::string_view origin, const AppSpec* app,
                         Keys* keys) {
  XAUTO_ASSIGN(const nlohmann::json document, json_document::parse(text, origin));
  Reader::Context context{std::string(origin), {}};
  const Reader root(context, &document, "");
  root.expect("xauto.deployment");
  std::set<std::string> modules;
  if (app != nullptr)
    for (const XNodeSpec& xnode : app->xnodes) modules.insert(xnode.module);
  const auto is_module = [&](const std::string& name) {
    return app == nullptr || modules.contains(name);
  };
  Deployment d;
  d.app = root["app"].text();
  if (app != nullptr && d.app != app->name && !root.failed())
    root["app"].refuse("is for app '" + d.app + "', not for '" + app->name + "'");
  if (root.has("queue_depth")) d.queue_depth = root["queue_depth"].integer(1, kMaxQueue);
  if (root.has("keep")) d.keep = root["keep"].integer(1, kMaxQueue);
  if (root.has("defaults")) {
    d.defaults = read_module(root["defaults"]);
    if (!d.defaults.parameters.empty())
      root["defaults"]["parameters"].refuse("is for all modules, and parameters are of one",
                                            "say it under \"modules\"");
    if (!d.defaults.remap.empty())
      root["defaults"]["remap"].refuse("is for all modules, and topics are renamed of one",
                                       "say it under \"modules\"");
  }
  if (root.has("instances"))
    root["instances"].each_member(kMaxInstances, [&](const std::string& name, const Reader& of) {
      if (name.empty()) return of.refuse("is of an instance without a name");
      std::string module = of.text();
      if (module.empty() && !of.failed()) return of.refuse("must be the name of an XModule");
      if (!is_module(name))
        return of.refuse("instance '" + name + "' is not in the app",
                         "`xauto profile --deployment` of this file writes an app that has it");
      d.instances.emplace(name, std::move(module));
    });
  if (root.has("modules"))
    root["modules"].each_member(kMaxXNodes, [&](const std::string& name, const Reader& module) {
      if (!is_module(name)) return module.refuse("XModule '" + name + "' is not in the app");
      d.modules.emplace(name, read_module(module));
    });
  if (root.has("budgets_us"))
    root["budgets_us"].each_member(kMaxXNodes, [&](const std::string& name, const Reader& budget) {
      if (app != nullptr && app->find(name) < 0)
        return budget.refuse("XNode '" + name + "' is not in the app");
      d.budgets_us.emplace(name, budget.integer(1, kMaxTimeUs));
    });
  std::set<std::string> names;
  if (root.has("chains"))
    root["chains"].each_element(kMaxChains, [&](std::size_t, const Reader& c) {
      ChainDeployment chain{c["name"].text(), c["from"].text(), c["to"].text(), {}, {}};
      if (c.failed()) return;
      if (!names.insert(chain.name).second)
        return c["name"].refuse("is the name of another chain, too");
      if (!is_module(chain.to))
        return c["to"].refuse("XModule '" + chain.to + "' is not in the app");
      if (c.has("deadline_us")) chain.deadline_us = c["deadline_us"].integer(1, kMaxTimeUs);
      if (c.has("max_age_us")) chain.max_age_us = c["max_age_us"].integer(1, kMaxTimeUs);
      d.chains.push_back(std::move(chain));
    });
  if (root.has("transport"))
    root["transport"].each_member(kMaxTransports, [&](const std::string& topic, const Reader& r) {
      if (topic.empty()) return r.refuse("is for a topic without a name");
      d.transport.emplace(topic, read_transport(r));
    });
  if (root.has("tables")) {
    const Reader tables = root["tables"];
    if (tables.has("dwell_us")) d.tables.dwell_us = tables["dwell_us"].integer(1, kMaxDwellUs);
    if (tables.has("margin_pct"))
      d.tables.margin_pct = tables["margin_pct"].integer(0, kMaxMarginPct);
  }
  XAUTO_TRY(context.status());
  for (const auto& [name, module] : d.modules) modules.insert(name);
  check(d, modules, root);
  XAUTO_TRY(context.status());
  if (keys != nullptr) *keys = context.keys(document);
  return d;
}

Result<Deployment> load(const std::string& path, const AppSpec* app) {
  XAUTO_ASSIGN(const std::string text, read_file(path));
  Keys keys;
  XAUTO_ASSIGN(Deployment deployment, parse(text, path, app, &keys));
  XAUTO_TRY(judge(keys, path));
  return deployment;
}

}  // namespace

Result<Deployment> parse_deployment(std::string_view text, std::string_view origin,
                                    const AppSpec& app, Keys* keys) {
  return parse(text, origin, &app, keys);
}
Result<Deployment> parse_deployment(std::string_view text, std::string_view origin) {
  return parse(text, origin, nullptr, nullptr);
}
Result<Deployment> load_deployment(const std::string& path, const AppSpec& app) {
  return load(path, &app);
}
Result<Deployment> load_deployment(const std::string& path) {
  return load(path, nullptr);
}

std::string to_json(const Deployment& d) {
  ordered_json document = {{"schema", "xauto.deployment"}, {"version", 1}, {"app", d.app}};
  if (d.queue_depth) document["queue_depth"] = *d.queue_depth;
  if (d.keep) document["keep"] = *d.keep;
  document["defaults"] = to_document(d.defaults);
  if (!d.instances.empty()) {
    ordered_json instances = ordered_json::object();
    for (const auto& [name, of] : d.instances) instances[name] = of;
    document["instances"] = std::move(instances);
  }
  ordered_json modules = ordered_json::object();
  for (const auto& [name, module] : d.modules) modules[name] = to_document(module);
  document["modules"] = std::move(modules);
  ordered_json budgets = ordered_json::object();
  for (const auto& [name, us] : d.budgets_us) budgets[name] = us;
  document["budgets_us"] = std::move(budgets);
  ordered_json chains = ordered_json::array();
  for (const ChainDeployment& c : d.chains) {
    ordered_json chain = {{"name", c.name}, {"from", c.from}, {"to", c.to}};
    if (c.deadline_us) chain["deadline_us"] = *c.deadline_us;
    if (c.max_age_us) chain["max_age_us"] = *c.max_age_us;
    chains.push_back(std::move(chain));
  }
  document["chains"] = std::move(chains);
  if (!d.transport.empty()) {
    ordered_json transport = ordered_json::object();
    for (const auto& [topic, where] : d.transport) transport[topic] = to_document(where);
    document["transport"] = std::move(transport);
  }
  if (d.tables != TablesDeployment{}) {
    ordered_json tables = ordered_json::object();
    if (d.tables.dwell_us) tables["dwell_us"] = *d.tables.dwell_us;
    if (d.tables.margin_pct) tables["margin_pct"] = *d.tables.margin_pct;
    document["tables"] = std::move(tables);
  }
  return json_document::to_text(document);
}

}  // namespace xauto
