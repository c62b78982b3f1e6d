// SPDX-License-Identifier: Apache-2.0
// "seen" and "todo" of app.json
#include <utility>

#include "model/imported.h"
#include "model/json.h"
#include "model/json_parts.h"

namespace xauto {

using namespace json_parts;

namespace {

constexpr std::pair<ExecutorKind, const char*> kKinds[] = {
    {ExecutorKind::kSingleThreaded, "single_threaded"},
    {ExecutorKind::kStaticSingleThreaded, "static_single_threaded"},
    {ExecutorKind::kMultiThreaded, "multi_threaded"},
    {ExecutorKind::kEvents, "events"}};
constexpr const char* kReentrant = "reentrant";
constexpr const char* kExclusive = "mutually_exclusive";

ExecutorKind read_kind(const Reader& type) {
  const std::string word = type.text();
  for (const auto& [kind, name] : kKinds)
    if (word == name) return kind;
  if (!type.failed())
    type.refuse("'" + word + "' is no executor",
                "single_threaded, static_single_threaded, multi_threaded or events");
  return ExecutorKind::kSingleThreaded;
}

void read_executors(const Reader& seen, const NameIndex& xnodes, Seen& into) {
  std::vector<char> there(xnodes.size(), 0);
  seen["executors"].each_element(kMaxExecutors, [&](std::size_t, const Reader& e) {
    SeenExecutor executor{e["name"].text(),
                          read_kind(e["type"]),
                          static_cast<int>(e["threads"].integer(1, kMaxSeenThreads)),
                          {}};
    e["groups"].each_element(kMaxXNodes, [&](std::size_t, const Reader& g) {
      SeenGroup group;
      const std::string type = g["type"].text();
      group.reentrant = type == kReentrant;
      if (!g.failed() && !group.reentrant && type != kExclusive)
        return g["type"].refuse("'" + type + "' is no callback group",
                                "mutually_exclusive or reentrant");
      g["xnodes"].each_element(kMaxXNodes, [&](std::size_t, const Reader& name) {
        const int x = read_name(name, xnodes, "XNode", "the app");
        if (name.failed()) return;
        if (std::exchange(there[static_cast<std::size_t>(x)], 1) != 0)
          return name.refuse("is in two groups");
        group.xnodes.push_back(x);
      });
      executor.groups.push_back(std::move(group));
    });
    into.executors.push_back(std::move(executor));
  });
}

void read_seen(const Reader& seen, const AppSpec& app, Seen& into) {
  const NameIndex xnodes = index_by_name(app.xnodes), chains = index_by_name(app.chains);
  into.from = seen["from"].text();
  into.duration_us = seen["duration_us"].integer(1, kMaxTimeUs);
  into.cores = static_cast<int>(seen["cores"].integer(1, kMaxSeenThreads));
  read_executors(seen, xnodes, into);
  into.xnodes.resize(app.xnodes.size());
  seen["xnodes"].each_element(kMaxXNodes, [&](std::size_t, const Reader& x) {
    const int found = read_name(x["name"], xnodes, "XNode", "the app");
    if (x.failed()) return;
    SeenXNode& one = into.xnodes[static_cast<std::size_t>(found)];
    one.times_us.clear();
    x["times_us"].each_element(kMaxSeenTimes, [&](std::size_t, const Reader& us) {
      one.times_us.push_back(us.integer(1, kMaxTimeUs));
    });
    if (x.has("delay_us")) one.delay_us = x["delay_us"].time();
    if (x.has("lead_us")) one.lead_us = x["lead_us"].time();
    if (x.has("depth")) one.depth = x["depth"].integer(1, kMaxInFlight);
  });
  if (!seen.has("chains")) return;
  seen["chains"].each_element(kMaxAppChains, [&](std::size_t, const Reader& c) {
    into.chains.push_back({read_name(c["name"], chains, "chain", "the app"),
                           c["count"].integer(1, kMaxTimeUs), c["p50_us"].time(),
                           c["p99_us"].time(), c["max_us"].time()});
  });
}

ordered_json names_of(const std::vector<int>& xnodes, const AppSpec& app) {
  ordered_json names = ordered_json::array();
  for (const int x : xnodes) names.push_back(app.xnodes[static_cast<std::size_t>(x)].name);
  return names;
}

ordered_json seen_to_json(const Seen& seen, const AppSpec& app) {
  ordered_json executors = ordered_json::array(), xnodes = ordered_json::array(),
               chains = ordered_json::array();
  for (const SeenExecutor& e : seen.executors) {
    ordered_json groups = ordered_json::array();
    for (const SeenGroup& g : e.groups)
      groups.push_back(
          {{"type", g.reentrant ? kReentrant : kExclusive}, {"xnodes", names_of(g.xnodes, app)}});
    executors.push_back({{"name", e.name},
                         {"type", name_of(e.kind)},
                         {"threads", e.threads},
                         {"groups", std::move(groups)}});
  }
  for (std::size_t x = 0; x < seen.xnodes.size(); ++x) {
    const SeenXNode& one = seen.xnodes[x];
    if (one == SeenXNode{}) continue;
    ordered_json xnode = {{"name", app.xnodes[x].name}};
    if (one.delay_us != 0) xnode["delay_us"] = one.delay_us;
    if (one.lead_us != 0) xnode["lead_us"] = one.lead_us;
    if (one.depth != 1) xnode["depth"] = one.depth;
    xnode["times_us"] = one.times_us;
    xnodes.push_back(std::move(xnode));
  }
  for (const SeenChain& c : seen.chains)
    chains.push_back({{"name", app.chains[static_cast<std::size_t>(c.chain)].name},
                      {"count", c.count},
                      {"p50_us", c.median_us},
                      {"p99_us", c.p99_us},
                      {"max_us", c.longest_us}});
  return {{"from", seen.from},           {"duration_us", seen.duration_us},
          {"cores", seen.cores},         {"executors", std::move(executors)},
          {"xnodes", std::move(xnodes)}, {"chains", std::move(chains)}};
}

}  // namespace

const char* name_of(ExecutorKind kind) {
  for (const auto& [one, name] : kKinds)
    if (one == kind) return name;
  return "";
}

std::string todo_text(const std::string& text) {
  std::string cut = text.substr(0, kMaxNameBytes);
  if (fault_of_name(cut).empty()) return cut;
  std::string whole = cut;  // a character may have been cut
  for (int less = 0; text.size() > kMaxNameBytes && less < 3; ++less) {
    whole.pop_back();
    if (fault_of_name(whole).empty()) return whole;
  }
  for (char& c : cut)
    if (c < 0x20 || c == 0x7f) c = '?';  // all that is no ASCII, too
  return cut;
}

Result<ImportedApp> parse_imported(std::string_view text, std::string_view origin) {
  ImportedApp imported;
  XAUTO_ASSIGN(imported.app, parse_app(text, origin));
  XAUTO_ASSIGN(const nlohmann::json document, json_document::parse(text, origin));
  Reader::Context context{std::string(origin), {}};
  const Reader root(context, &document, "");
  if (root.has("groups"))
    root["groups"].each_element(kMaxXNodes, [&](std::size_t, const Reader& group) {
      std::vector<std::string>& names = imported.groups.emplace_back();
      group.each_element(kMaxXNodes,
                         [&](std::size_t, const Reader& name) { names.push_back(name.text()); });
    });
  if (root.has("seen")) read_seen(root["seen"], imported.app, imported.seen);
  if (root.has("todo"))
    root["todo"].each_element(kMaxTodo, [&](std::size_t, const Reader& todo) {
      imported.todo.push_back(
          {todo.has("at") ? todo["at"].text() : std::string(), todo["what"].text()});
    });
  XAUTO_TRY(context.status());
  return imported;
}

Result<ImportedApp> load_imported(const std::string& path) {
  XAUTO_ASSIGN(const std::string text, read_file(path));
  return parse_imported(text, path);
}

std::string to_json(const ImportedApp& imported) {
  ordered_json document = ordered_json::parse(to_json(imported.app));
  if (!imported.groups.empty()) document["groups"] = imported.groups;
  if (!imported.todo.empty()) {
    ordered_json& list = document["todo"] = ordered_json::array();
    for (const Todo& t : imported.todo) {
      ordered_json todo;
      if (!t.at.empty()) todo["at"] = t.at;
      todo["what"] = t.what;
      list.push_back(std::move(todo));
    }
  }
  if (!imported.seen.from.empty()) document["seen"] = seen_to_json(imported.seen, imported.app);
  return json_document::to_text(document);
}

}  // namespace xauto
