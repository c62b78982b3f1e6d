// SPDX-License-Identifier: Apache-2.0
#include "model/app.h"

#include <algorithm>
#include <functional>
#include <queue>
#include <set>
#include <string_view>
#include <tuple>
#include <unordered_map>

#include "base/fnv.h"
#include "base/index.h"
#include "base/utf8.h"
#include "model/contention.h"
#include "model/loss.h"
#include "model/periodic.h"
#include "model/refusal.h"

namespace xauto {
namespace {

/// XNodes of one cycle among those that a topological order leaves out, in order, first repeated at
/// the end.
std::string cycle_text(const AppSpec& app, const std::vector<int>& order) {
  std::vector<char> ordered(app.xnodes.size(), 0);
  for (const int i : order) ordered[at(i)] = 1;
  // Every XNode left has a predecessor that is left: walking backwards must come round.
  const auto pred = app.predecessors();
  int node = 0;
  while (ordered[at(node)]) ++node;
  std::vector<int> path;
  std::vector<char> seen(app.xnodes.size(), 0);
  while (!seen[at(node)]) {
    seen[at(node)] = 1;
    path.push_back(node);
    for (const int p : pred[at(node)])
      if (!ordered[at(p)]) {
        node = p;
        break;
      }
  }
  path.erase(path.begin(), std::find(path.begin(), path.end(), node));
  std::reverse(path.begin(), path.end());
  std::string text = quoted(app.xnodes[at(path.back())].name);
  for (const int i : path) text += " -> " + quoted(app.xnodes[at(i)].name);
  return text;
}

/// The first edge that is there before; a sort, since two million in a tree take seconds.
std::optional<std::size_t> second_of_two(const std::vector<std::pair<int, int>>& edges) {
  std::vector<std::pair<std::pair<int, int>, std::size_t>> sorted;
  sorted.reserve(edges.size());
  for (std::size_t i = 0; i < edges.size(); ++i) sorted.emplace_back(edges[i], i);
  std::sort(sorted.begin(), sorted.end());
  std::optional<std::size_t> found;
  for (std::size_t k = 1; k < sorted.size(); ++k)
    if (sorted[k].first == sorted[k - 1].first && (!found || sorted[k].second < *found))
      found = sorted[k].second;
  return found;
}

void add_wcets(Fnv& fnv, const std::map<std::string, std::int64_t, std::less<>>& wcet_us) {
  fnv.add(static_cast<std::int64_t>(wcet_us.size()));
  for (const auto& [type, us] : wcet_us) {
    fnv.add(type);
    fnv.add(us);
  }
}

/// In any order. Without any the hash is that of files written before there were some.
void add_beside(Fnv& fnv, std::vector<BesideSpec> beside) {
  std::sort(beside.begin(), beside.end(), [](const BesideSpec& a, const BesideSpec& b) {
    return std::tie(a.on, a.load) < std::tie(b.on, b.load);
  });
  fnv.add("beside");
  fnv.add(static_cast<std::int64_t>(beside.size()));
  for (const BesideSpec& b : beside) {
    fnv.add(b.on);
    add_wcets(fnv, b.load);
    fnv.add(b.wcet_us);
  }
}

void add_variants(Fnv& fnv, const XNodeSpec& x) {
  fnv.add(static_cast<std::int64_t>(x.variants.size()));
  for (const VariantSpec& variant : x.variants) {
    fnv.add(variant.name);
    fnv.add(variant.quality_pct);
    add_wcets(fnv, variant.wcet_us);
  }
}

/// Each list with its size, so that an entry of one is never read as one of
/// the next.
void add_periodic(Fnv& fnv, const AppSpec& app) {
  const auto size = [&](std::size_t count) { fnv.add(static_cast<std::int64_t>(count)); };
  size(app.sources.size());
  for (const SourceSpec& source : app.sources) {
    fnv.add(source.name);
    for (const std::int64_t value :
         {source.period.num, source.period.den, source.offset_us, source.jitter_us})
      fnv.add(value);
    fnv.add(app.clocks[at(source.clock)].name);
    fnv.add(app.clocks[at(source.clock)].ppm);
    if (source.urgent) {  // without it the hash is that of files written before there was one
      fnv.add("urgent");
      fnv.add(source.urgent->by_us);
      fnv.add(source.urgent->every_us);
      if (!source.urgent->marked_by.empty()) fnv.add(source.urgent->marked_by);
    }
  }
  // By name: the order of the modules in the file means nothing.
  std::vector<const ModuleSpec*> modules;
  for (const ModuleSpec& module : app.modules) modules.push_back(&module);
  std::sort(modules.begin(), modules.end(),
            [](const ModuleSpec* a, const ModuleSpec* b) { return a->name < b->name; });
  size(modules.size());
  for (const ModuleSpec* module : modules) {
    fnv.add(module->name);
    fnv.add(module->max_in_flight);
    fnv.add(module->optional ? 1 : 0);
    if (!module->host.empty()) fnv.add("host " + module->host);
  }
  for (const XNodeSpec& x : app.xnodes) {
    std::vector<int> heard = x.sources;
    std::sort(heard.begin(), heard.end());
    size(heard.size());
    for (const int source : heard) fnv.add(source);
    add_variants(fnv, x);
    if (x.message_bytes > 0) fnv.add("bytes " + std::to_string(x.message_bytes));
  }
  std::vector<std::pair<int, int>> samples = app.samples;
  std::sort(samples.begin(), samples.end());
  size(samples.size());
  for (const auto& [u, v] : samples) {
    fnv.add(u);
    fnv.add(v);
  }
  size(app.chains.size());
  for (const ChainSpec& chain : app.chains) {
    fnv.add(chain.name);
    for (const std::int64_t value : {std::int64_t{chain.from}, std::int64_t{chain.to},
                                     chain.deadline_us.value_or(0), chain.weight})
      fnv.add(value);
  }
  std::map<std::tuple<int, int, std::string_view, std::string_view>, std::int64_t> transfers;
  for (const TransferSpec& t : app.transfers) {
    const auto [u, v] = app.edges[at(t.edge)];
    if (t.transfer_us > 0) transfers[{u, v, t.from_type, t.to_type}] = t.transfer_us;
  }
  size(transfers.size());
  for (const auto& [key, us] : transfers) {
    fnv.add(std::get<0>(key));
    fnv.add(std::get<1>(key));
    fnv.add(std::get<2>(key));
    fnv.add(std::get<3>(key));
    fnv.add(us);
  }
}

/// Every module that an XNode names is listed.
Status validate_modules(const AppSpec& app) {
  XAUTO_TRY(validate_names(app.modules, "modules", "module"));
  std::set<std::string_view> named, listed;
  for (const ModuleSpec& module : app.modules) listed.insert(module.name);
  for (std::size_t i = 0; i < app.xnodes.size(); ++i) {
    const XNodeSpec& x = app.xnodes[i];
    named.insert(x.module);
    if (x.module.empty())
      return invalid("XNode " + quoted(x.name) + " needs a module", nth("xnodes", i) + "/module");
    if (!listed.contains(x.module))
      return invalid("module " + quoted(x.module) + " is not in \"modules\"",
                     nth("xnodes", i) + "/module");
  }
  for (std::size_t m = 0; m < app.modules.size(); ++m) {
    if (!named.contains(app.modules[m].name))
      return invalid("no XNode is in module " + quoted(app.modules[m].name),
                     nth("modules", m) + "/name");
    XAUTO_TRY(in_range(app.modules[m].max_in_flight, 1, kMaxInFlight, "a number of activations",
                       nth("modules", m) + "/max_in_flight"));
  }
  return {};
}

}  // namespace

std::optional<std::int64_t> XNodeSpec::wcet_on(std::string_view type) const {
  const auto found = wcet_us.find(type);
  if (found == wcet_us.end()) return std::nullopt;
  return found->second;
}

int XNodeSpec::find_variant(std::string_view variant) const {
  for (std::size_t v = 0; v < variants.size(); ++v)
    if (variants[v].name == variant) return static_cast<int>(v);
  return -1;
}

bool AppSpec::has_deadlines() const {
  return std::any_of(chains.begin(), chains.end(),
                     [](const ChainSpec& chain) { return chain.deadline_us.has_value(); });
}

int AppSpec::find(std::string_view xnode) const {
  for (std::size_t i = 0; i < xnodes.size(); ++i)
    if (xnodes[i].name == xnode) return static_cast<int>(i);
  return -1;
}

std::size_t AppSpec::rates() const {
  std::set<Period> periods;
  for (const SourceSpec& source : sources) periods.insert(source.period);
  return periods.size();
}

std::vector<std::int64_t> AppSpec::periods() const {
  constexpr std::int64_t kUnknown = -1;
  std::vector<std::int64_t> period(xnodes.size(), 0);
  const auto pred = predecessors();
  for (const int i : topological_order()) {
    std::int64_t& own = period[at(i)];
    if (pred[at(i)].empty() && xnodes[at(i)].sources.empty()) own = kUnknown;
    for (const int s : xnodes[at(i)].sources) own = std::max(own, sources[at(s)].period.floor_us());
    for (const int p : pred[at(i)])
      own = own == kUnknown || period[at(p)] == kUnknown ? kUnknown : std::max(own, period[at(p)]);
  }
  for (std::int64_t& own : period) own = std::max<std::int64_t>(own, 0);
  return period;
}

std::vector<std::vector<int>> AppSpec::predecessors() const {
  std::vector<std::vector<int>> result(xnodes.size());
  for (const auto& [u, v] : edges) result[at(v)].push_back(u);
  return result;
}

std::vector<std::vector<int>> AppSpec::successors() const {
  std::vector<std::vector<int>> result(xnodes.size());
  for (const auto& [u, v] : edges) result[at(u)].push_back(v);
  return result;
}

std::vector<int> AppSpec::topological_order(const std::vector<std::pair<int, int>>& order) const {
  std::vector<int> missing(xnodes.size(), 0), sorted;
  auto succ = successors();
  for (const auto& [u, v] : order) succ[at(u)].push_back(v);
  for (const auto* pairs : {&edges, &order})
    for (const auto& [u, v] : *pairs) ++missing[at(v)];
  std::priority_queue<int, std::vector<int>, std::greater<>> ready;
  for (std::size_t i = 0; i < xnodes.size(); ++i)
    if (missing[i] == 0) ready.push(static_cast<int>(i));
  while (!ready.empty()) {
    const int i = ready.top();
    ready.pop();
    sorted.push_back(i);
    for (const int s : succ[at(i)])
      if (--missing[at(s)] == 0) ready.push(s);
  }
  return sorted;
}

std::string AppSpec::hash() const {
  Fnv fnv;
  if (one_at_a_time) fnv.add("one at a time");
  fnv.add(name);
  fnv.add(static_cast<std::int64_t>(xnodes.size()));
  for (const XNodeSpec& x : xnodes) {
    fnv.add(x.name);
    fnv.add(x.module);
    add_wcets(fnv, x.wcet_us);
    if (!x.beside.empty()) add_beside(fnv, x.beside);
  }
  std::vector<std::pair<int, int>> sorted = edges;
  std::sort(sorted.begin(), sorted.end());
  for (const auto& [u, v] : sorted) {
    fnv.add(u);
    fnv.add(v);
  }
  fnv.add(deadline_us.value_or(0));
  add_periodic(fnv, *this);
  return fnv.hex();
}

namespace {

Status is_every_end(const std::string& what, const std::string& where) {
  return invalid("'*' is no name: as the end of a chain it is every " + what, where + "/name");
}

}  // namespace

Status validate(const std::vector<SourceSpec>& sources) {
  if (sources.size() > kMaxSources)
    return fail(ErrorCode::kInvalid,
                std::to_string(sources.size()) + " sources; at most " +
                    std::to_string(kMaxSources) + " are possible",
                "/sources");
  std::set<std::string_view> names;
  for (std::size_t i = 0; i < sources.size(); ++i) {
    const SourceSpec& source = sources[i];
    const std::string where = "/sources/" + std::to_string(i);
    if (source.name.empty())
      return fail(ErrorCode::kInvalid, "a source needs a name", where + "/name");
    if (source.name.size() > kMaxNameBytes)
      return fail(ErrorCode::kInvalid,
                  "a name is longer than " + std::to_string(kMaxNameBytes) + " bytes",
                  where + "/name");
    if (source.name == kEveryEnd) return is_every_end("source", where);
    if (!names.insert(source.name).second)
      return fail(ErrorCode::kInvalid, "two sources are called " + quoted(source.name),
                  where + "/name");
    if (!source.period.valid())
      return fail(ErrorCode::kInvalid,
                  "source " + quoted(source.name) + ": " + source.period.text() +
                      " is not a period from 1 to " + std::to_string(kMaxPeriodUs) + " us",
                  where + "/period_us");
  }
  return {};
}

Status validate_heard(const std::vector<int>& heard, std::size_t sources, bool has_predecessor,
                      const std::string& where) {
  if (heard.empty()) return {};
  if (has_predecessor)
    return fail(ErrorCode::kInvalid, "an XNode with predecessors hears of sources through them",
                where);
  const std::set<int> distinct(heard.begin(), heard.end());
  if (distinct.size() != heard.size())
    return fail(ErrorCode::kInvalid, "names a source twice", where);
  if (*distinct.begin() < 0 || at(*distinct.rbegin()) >= sources)
    return fail(ErrorCode::kInvalid, "names an unknown source", where);
  return {};
}

Status validate_xnodes(const AppSpec& app) {
  if (app.xnodes.empty() || app.xnodes.size() > kMaxXNodes)
    return fail(ErrorCode::kInvalid,
                std::to_string(app.xnodes.size()) + " XNodes; 1 to " + std::to_string(kMaxXNodes) +
                    " are possible",
                "/xnodes");
  std::unordered_map<std::string_view, std::size_t> names;
  for (std::size_t i = 0; i < app.xnodes.size(); ++i) {
    const XNodeSpec& x = app.xnodes[i];
    const std::string where = "/xnodes/" + std::to_string(i);
    if (x.name.empty()) return fail(ErrorCode::kInvalid, "an XNode needs a name", where + "/name");
    if (x.name.size() > kMaxNameBytes || x.module.size() > kMaxNameBytes)
      return fail(ErrorCode::kInvalid,
                  "a name is longer than " + std::to_string(kMaxNameBytes) + " bytes", where);
    if (x.name == kEveryEnd) return is_every_end("XNode", where);
    if (!names.try_emplace(x.name, i).second)
      return fail(ErrorCode::kInvalid, "two XNodes are called " + quoted(x.name), where + "/name");
    if (x.wcet_us.empty())
      return fail(ErrorCode::kInvalid, "XNode " + quoted(x.name) + " has no implementation",
                  where + "/wcet_us", "give a WCET for at least one XPU type");
    for (const auto& [type, us] : x.wcet_us) {
      if (type.empty())
        return fail(ErrorCode::kInvalid,
                    "XNode " + quoted(x.name) + " has an XPU type without name",
                    where + "/wcet_us");
      if (us < 1 || us > kMaxTimeUs)
        return fail(ErrorCode::kInvalid,
                    "XNode " + quoted(x.name) + ": " + std::to_string(us) +
                        " is not a WCET from 1 to " + std::to_string(kMaxTimeUs) + " us",
                    where + "/wcet_us/" + type);
    }
    XAUTO_TRY(validate_beside(x, where + "/beside"));
  }
  return {};
}

Status validate_graph(const AppSpec& app) {
  XAUTO_TRY(validate(app.sources));
  XAUTO_TRY(validate_xnodes(app));
  if (app.edges.size() > kMaxEdges)
    return fail(ErrorCode::kInvalid,
                std::to_string(app.edges.size()) + " edges; at most " + std::to_string(kMaxEdges) +
                    " are possible",
                "/edges");
  if (app.deadline_us && (*app.deadline_us < 1 || *app.deadline_us > kMaxTimeUs))
    return fail(ErrorCode::kInvalid,
                std::to_string(*app.deadline_us) + " is not a deadline from 1 to " +
                    std::to_string(kMaxTimeUs) + " us",
                "/deadline_us");
  for (std::size_t i = 0; i < app.edges.size(); ++i) {
    const auto [u, v] = app.edges[i];
    const std::string where = "/edges/" + std::to_string(i);
    const auto known = [&](int x) { return x >= 0 && at(x) < app.xnodes.size(); };
    if (!known(u) || !known(v)) return fail(ErrorCode::kInvalid, "names an unknown XNode", where);
    if (u == v)
      return fail(ErrorCode::kInvalid,
                  "XNode " + quoted(app.xnodes[at(u)].name) + " precedes itself", where);
  }
  if (const auto i = second_of_two(app.edges))
    return fail(ErrorCode::kInvalid,
                "edge " + quoted(app.xnodes[at(app.edges[*i].first)].name) + " -> " +
                    quoted(app.xnodes[at(app.edges[*i].second)].name) + " is there twice",
                "/edges/" + std::to_string(*i));
  const auto pred = app.predecessors();
  for (std::size_t i = 0; i < app.xnodes.size(); ++i)
    XAUTO_TRY(validate_heard(app.xnodes[i].sources, app.sources.size(), !pred[i].empty(),
                             "/xnodes/" + std::to_string(i) + "/source"));
  const std::vector<int> order = app.topological_order();
  if (order.size() != app.xnodes.size())
    return fail(ErrorCode::kInvalid, "cycle of XNodes: " + cycle_text(app, order), "/edges");
  return {};
}

Status validate(const AppSpec& app) {
  XAUTO_TRY(validate_graph(app));
  XAUTO_TRY(validate_modules(app));
  XAUTO_TRY(validate_periodic(app));
  return validate_losses(app);
}

Status validate_on(const AppSpec& app, const Platform& platform) {
  const std::vector<std::string> types = platform.types();
  for (std::size_t i = 0; i < app.xnodes.size(); ++i) {
    const XNodeSpec& x = app.xnodes[i];
    const bool runs = std::any_of(types.begin(), types.end(), [&](const std::string& type) {
      return x.wcet_us.contains(type);
    });
    if (runs) continue;
    std::string has;
    for (const auto& [type, us] : x.wcet_us) has += (has.empty() ? "" : ", ") + type;
    return fail(ErrorCode::kInfeasible,
                "XNode " + quoted(x.name) + " runs on " + has + " only, which platform '" +
                    platform.name + "' lacks",
                "/xnodes/" + std::to_string(i) + "/wcet_us");
  }
  XAUTO_TRY(validate_beside_on(app, platform));
  std::int64_t switch_us = 0, total = 0;
  for (const Xpu& xpu : platform.xpus)
    if (xpu.preemptive) switch_us = std::max(switch_us, xpu.preempt_us);
  for (const XNodeSpec& x : app.xnodes) {
    std::int64_t longest = 0;
    for (const std::string& type : types) longest = std::max(longest, longest_wcet(x, type));
    total += longest + switch_us;  // at most 2 * 10^12 each, 20 000 of them
  }
  // What delays a release without occupying an XPU: at most 10^12 each, 2 000 000 of them.
  for (const TransferSpec& transfer : app.transfers) total += transfer.transfer_us;
  std::int64_t latest = 0;
  for (const SourceSpec& source : app.sources)
    latest = std::max(latest, source.offset_us + source.jitter_us);
  total += latest;
  // kNoRate is longer than any release.
  const std::int64_t most = app.one_at_a_time ? kNoRate.floor_us() : kMaxTimeUs;
  if (total > most)
    return fail(
        ErrorCode::kInvalid,
        "the WCETs, with a preemption each, transfers, offsets and jitter sum to " +
            std::to_string(total) + " us; " +
            (app.one_at_a_time ? "a release takes up to " : "policy.json holds times up to ") +
            std::to_string(most) + " us",
        "/xnodes", "is the unit a microsecond?");
  return {};
}

std::string fault_of_name(const std::string& name) {
  if (name.size() > kMaxNameBytes)
    return "is longer than " + std::to_string(kMaxNameBytes) + " bytes";
  for (std::size_t i = 0; i < name.size();) {
    const std::size_t length = utf8_length(std::string_view(name).substr(i));
    if (length == 0) return "is no UTF-8";
    const auto byte = static_cast<unsigned char>(name[i]);
    if (byte < 0x20 || byte == 0x7f ||
        (byte == 0xc2 && static_cast<unsigned char>(name[i + 1]) < 0xa0))
      return "has a control character";
    i += length;
  }
  return "";
}

}  // namespace xauto
