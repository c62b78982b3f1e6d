// SPDX-License-Identifier: Apache-2.0
// policy.json
#include <cstdint>

#include "model/json.h"
#include "model/json_parts.h"

namespace xauto {

using namespace json_parts;

namespace {

void read_head(const Reader& root, Policy& policy) {
  root.expect("xauto.policy", kAppVersion, "solve again");
  policy.app = root["app"].text();
  policy.app_hash = root["app_hash"].text();
  if (root.has("platform")) policy.platform = root["platform"].text();
  policy.method = root["method"].text();
}

/// What is left once all has been read; `keys` as in parse_policy.
Result<Policy> accept(Policy policy, const Reader& root, const Reader::Context& context,
                      const nlohmann::json& document, const AppSpec& app, const Platform& platform,
                      const std::vector<std::size_t>& line_of, Keys* keys) {
  if (root.has("solve_us")) policy.solve_us = root["solve_us"].integer(0, kMaxTimeUs);
  XAUTO_TRY(context.status());
  Status valid = validate(policy, app, platform);
  if (!valid) valid = in_file_order(std::move(valid).error(), "xnodes", line_of);
  XAUTO_TRY(in_file(std::move(valid), context.origin));
  if (keys != nullptr) *keys = context.keys(document);
  return policy;
}

int read_xpu(const Reader& x, const Platform& platform) {
  const std::string id = x["xpu"].text();
  const int xpu = platform.find(id);
  if (!x.failed() && xpu < 0)
    x["xpu"].refuse("XPU '" + id + "' is not in platform '" + platform.name + "'");
  return xpu;
}

int read_host(const Reader& name, const Platform& platform) {
  const int host = platform.find_host(name.text());
  if (!name.failed() && host < 0)
    name.refuse("host '" + name.text() + "' is not in platform '" + platform.name + "'");
  return host;
}

void read_crossings(const Reader& root, const AppSpec& app, const Platform& platform,
                    Policy& policy) {
  root.knows({"crossings/*/from", "crossings/*/to", "crossings/*/x_us"});
  if (!root.has("crossings")) return;
  const NameIndex xnodes = index_by_name(app.xnodes);
  root["crossings"].each_element(kMaxXNodes * kMaxHosts, [&](std::size_t, const Reader& x) {
    policy.crossings.push_back({read_name(x["from"], xnodes, "XNode", "the app"),
                                read_host(x["to"], platform), x["x_us"].time()});
  });
}

/// Its keys, and until when it is held; or a priority.
void read_urgency(const Reader& x, Placement& p) {
  if (!x.has("priority")) {
    if (!x.has("key_us")) return x.refuse("has neither \"key_us\" nor \"priority\"");
    p.key_us = read_series(x, "key_us", true);
    p.hold_us = read_series(x, "hold_us", false);
    return;
  }
  for (const char* key : {"key_us", "hold_us", "start_us", "finish_us", "wcet_us", "reads_all"})
    if (x.has(key))
      return x[key].refuse("stands beside a priority, of which no time is known",
                           "give the XNode a priority, or keys and their times");
  p.priority = x["priority"].integer(-kMaxTimeUs, kMaxTimeUs);
}

/// each(XNode of the app, its line). Returns which line of the file that was.
template <class Each>
std::vector<std::size_t> read_placements(const Reader& root, const AppSpec& app,
                                         const NameIndex& index, Each each) {
  constexpr std::size_t kNowhere = SIZE_MAX;
  std::vector<std::size_t> line_of(app.xnodes.size(), kNowhere);
  root["xnodes"].each_element(kMaxXNodes, [&](std::size_t line, const Reader& x) {
    const int found = read_name(x["name"], index, "XNode", "the app");
    if (x.failed()) return;
    const auto i = static_cast<std::size_t>(found);
    if (line_of[i] != kNowhere)
      return x["name"].refuse("XNode '" + app.xnodes[i].name + "' is placed twice");
    line_of[i] = line;
    each(i, x);
  });
  if (root.failed()) return line_of;
  for (std::size_t i = 0; i < line_of.size(); ++i)
    if (line_of[i] == kNowhere) {
      root["xnodes"].refuse("XNode '" + app.xnodes[i].name + "' is not placed");
      break;
    }
  return line_of;
}

void read_claims(const Reader& root, const AppSpec& app, Policy& policy) {
  policy.chains.resize(app.chains.size());
  each_chain(root, app, [&](std::size_t k, const Reader& c) {
    policy.chains[k] = {app.chains[k].name, c["worst_case_us"].time(), c["lower_bound_us"].time(),
                        c["optimal"].boolean()};
    if (c.has("urgent_worst_case_us"))
      policy.chains[k].urgent_worst_case_us = c["urgent_worst_case_us"].time();
  });
}

}  // namespace

Result<Policy> parse_policy(std::string_view text, std::string_view origin, const AppSpec& app,
                            const Platform& platform, Keys* keys) {
  XAUTO_ASSIGN(const nlohmann::json document, json_document::parse(text, origin));
  Reader::Context context{std::string(origin), {}};
  const Reader root(context, &document, "");
  Policy policy;
  read_head(root, policy);
  policy.placements.resize(app.xnodes.size());
  const std::vector<std::size_t> line_of =
      read_placements(root, app, index_by_name(app.xnodes), [&](std::size_t i, const Reader& x) {
        Placement& p = policy.placements[i];
        p.xpu = read_xpu(x, platform);
        read_urgency(x, p);
        if (p.priority) return;
        p.start_us = read_series(x, "start_us", false);
        p.finish_us = read_series(x, "finish_us", false);
        if (x.has("wcet_us")) p.wcet_us = x["wcet_us"].integer(1, kMaxTimeUs);
        p.reads_all = x.has("reads_all") && x["reads_all"].boolean();
      });
  if (root.has("order")) policy.order = read_pairs(root["order"], index_by_name(app.xnodes));
  read_crossings(root, app, platform, policy);
  if (root.has("certified")) policy.certified = root["certified"].boolean();
  if (policy.certified &&
      !policy.by_priority())  // of priorities validate() says that nothing can be claimed
    read_claims(root, app, policy);
  else if (policy.certified)
    (void)root.has("chains");
  else if (root.has("chains"))
    root["chains"].refuse("claims something, and the policy is not certified",
                          "nothing is claimed of what no proof is known of: solve again");
  return accept(std::move(policy), root, context, document, app, platform, line_of, keys);
}

Result<Policy> parse_key_hint(std::string_view text, std::string_view origin, const AppSpec& app,
                              const Platform& platform) {
  XAUTO_ASSIGN(const nlohmann::json document, json_document::parse(text, origin));
  Reader::Context context{std::string(origin), {}};
  const Reader root(context, &document, "");
  Policy policy;
  read_head(root, policy);
  if (!root.failed() && policy.app != app.name)
    root["app"].refuse("is '" + policy.app + "', this is '" + app.name + "'",
                       "take a policy of this app; it may be of an earlier version of it");
  const NameIndex index = index_by_name(app.xnodes);
  policy.placements.resize(app.xnodes.size());
  std::vector<char> there(app.xnodes.size(), 0);
  root["xnodes"].each_element(kMaxXNodes, [&](std::size_t, const Reader& x) {
    const std::string name = x["name"].text(), xpu = x["xpu"].text();
    Placement placed{platform.find(xpu)};
    read_urgency(x, placed);
    if (x.failed()) return;
    placed.priority.reset();  // where it is, and no key
    if (placed.key_us.empty() && !x.has("priority"))
      return x["key_us"].refuse("XNode '" + name + "' has no key");
    const auto found = index.find(name);
    if (found == index.end()) return;  // it is no more
    const auto i = static_cast<std::size_t>(found->second);
    if (there[i]) return x["name"].refuse("XNode '" + name + "' is placed twice");
    there[i] = 1;
    if (placed.xpu >= 0) policy.placements[i] = std::move(placed);
  });
  if (root.has("order"))
    root["order"].each_element(kMaxEdges, [&](std::size_t, const Reader& pair) {
      int ends[2] = {-1, -1};
      std::size_t count = 0;
      pair.each_element(2, [&](std::size_t, const Reader& end) {
        if (const auto found = index.find(end.text()); found != index.end())
          ends[count] = found->second;
        ++count;
      });
      if (ends[0] < 0 || ends[1] < 0) return;  // of an XNode that is no more
      const int xpu = policy.placements[static_cast<std::size_t>(ends[0])].xpu;
      if (xpu >= 0 && xpu == policy.placements[static_cast<std::size_t>(ends[1])].xpu)
        policy.order.emplace_back(ends[0], ends[1]);
    });
  XAUTO_TRY(context.status());
  return policy;
}

std::string to_json(const Policy& policy, const AppSpec& app, const Platform& platform) {
  ordered_json xnodes = ordered_json::array();
  for (std::size_t i = 0; i < policy.placements.size(); ++i) {
    const Placement& p = policy.placements[i];
    ordered_json xnode = {{"name", app.xnodes[i].name},
                          {"xpu", platform.xpus[static_cast<std::size_t>(p.xpu)].id}};
    if (p.priority)
      xnode["priority"] = *p.priority;
    else
      xnode["key_us"] = p.key_us;
    if (!p.hold_us.empty()) xnode["hold_us"] = p.hold_us;
    if (!p.start_us.empty()) xnode["start_us"] = p.start_us;
    if (!p.finish_us.empty()) xnode["finish_us"] = p.finish_us;
    if (p.wcet_us) xnode["wcet_us"] = *p.wcet_us;
    if (p.reads_all) xnode["reads_all"] = true;
    xnodes.push_back(std::move(xnode));
  }
  ordered_json document = {{"schema", "xauto.policy"},    {"version", kAppVersion},
                           {"app", policy.app},           {"app_hash", policy.app_hash},
                           {"platform", policy.platform}, {"method", policy.method}};
  document["xnodes"] = std::move(xnodes);
  if (!policy.order.empty())
    document["order"] = pairs_to_json(
        policy.order, [&](int i) { return app.xnodes[static_cast<std::size_t>(i)].name; });
  for (const Crossing& c : policy.crossings)
    document["crossings"].push_back({{"from", app.xnodes[static_cast<std::size_t>(c.from)].name},
                                     {"to", platform.hosts[static_cast<std::size_t>(c.host)].name},
                                     {"x_us", c.x_us}});
  if (policy.certified)
    document["chains"] = ordered_json::array();
  else
    document["certified"] = false;
  for (const ChainClaim& c : policy.chains) {
    document["chains"].push_back({{"name", c.name},
                                  {"worst_case_us", c.worst_case_us},
                                  {"lower_bound_us", c.lower_bound_us},
                                  {"optimal", c.optimal}});
    if (c.urgent_worst_case_us)
      document["chains"].back()["urgent_worst_case_us"] = *c.urgent_worst_case_us;
  }
  document["solve_us"] = policy.solve_us;
  return json_document::to_text(document);
}

}  // namespace xauto
