// SPDX-License-Identifier: Apache-2.0
#include "import/questions.h"

#include <algorithm>
#include <functional>
#include <numeric>
#include <utility>

#include "base/index.h"

namespace xauto::import {
namespace {

constexpr std::size_t kMostXpusAsked = 3, kMostNameBytes = 120;

}  // namespace

std::string counted(std::size_t count, const char* what) {
  return std::to_string(count) + " " + what + (count == 1 ? "" : "s");
}

std::string bare(const std::string& name) {
  const std::string plain =
      name.substr(std::min(name.find_first_not_of('/'), name.size())).substr(0, kMostNameBytes);
  return plain.empty() || !fault_of_name(plain).empty() ? "unnamed" : plain;
}

Status is_app(const AppSpec& app, const char* made, const std::string& where) {
  Status valid = validate(app);
  if (valid) return valid;
  Error error = valid.error();
  if (!where.empty()) error.where = where;
  error.what = std::string(made) + " is no app: " + error.what;
  return tl::unexpected<Error>(std::move(error));
}

std::int64_t up_to_us(std::int64_t ns) {
  return (ns + 999) / 1000;
}

std::int64_t with_margin(std::int64_t us, std::int64_t margin_pct) {
  const double more = static_cast<double>(us) * (1 + static_cast<double>(margin_pct) / 100);
  return std::max<std::int64_t>(
      1, static_cast<std::int64_t>(std::min(more, static_cast<double>(kMaxTimeUs))));
}

void todo(ImportedApp& imported, std::string at, const std::string& what) {
  if (imported.todo.size() < kMaxTodo) imported.todo.push_back({std::move(at), todo_text(what)});
}

void ask_deadlines(ImportedApp& imported) {
  const std::vector<ChainSpec>& chains = imported.app.chains;
  const auto unknown = static_cast<std::size_t>(
      std::ranges::count_if(chains, [](const ChainSpec& c) { return !c.deadline_us; }));
  if (unknown > kMostAsked)
    return todo(imported, "/deadline_us", "what is the deadline of the chains, in us?");
  for (std::size_t k = 0; k < chains.size(); ++k)
    if (!chains[k].deadline_us)
      todo(imported, "/chains/" + std::to_string(k) + "/deadline_us",
           "what is the deadline of chain '" + chains[k].name + "', in us?");
}

void ask_jitters(ImportedApp& imported) {
  for (std::size_t s = 0; s < imported.app.sources.size(); ++s)
    if (imported.app.sources[s].clock != 0)
      todo(imported, "/sources/" + std::to_string(s) + "/jitter_us",
           "what jitter does the driver of '" + imported.app.sources[s].name +
               "' state, in us? its rate and jitter are as seen");
}

void ask_other_xpus(ImportedApp& imported, const std::vector<double>& load) {
  std::vector<int> by_load(imported.app.xnodes.size());
  std::iota(by_load.begin(), by_load.end(), 0);
  std::ranges::stable_sort(by_load, std::greater(), [&](int x) { return load[at(x)]; });
  for (std::size_t n = 0; n < std::min(by_load.size(), kMostXpusAsked); ++n) {
    const XNodeSpec& xnode = imported.app.xnodes[at(by_load[n])];
    const bool on_gpu = xnode.wcet_us.contains("gpu");
    todo(imported, "/xnodes/" + std::to_string(by_load[n]) + "/wcet_us",
         "on which other XPU could '" + xnode.name + "' run, and how long at most? {\"" +
             (on_gpu ? "dla" : "gpu") + "\": MICROSECONDS}");
  }
}

}  // namespace xauto::import
