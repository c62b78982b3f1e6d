// SPDX-License-Identifier: Apache-2.0
#include "session/account.h"

#include <algorithm>
#include <utility>

#include <fmt/format.h>

#include "base/quantile.h"
#include "model/claims.h"
#include "model/json_value.h"

namespace xauto::runtime {
namespace {

/// By how much the worst result was longer than what is claimed of it.
std::int64_t exceeded_by_us(const std::vector<ChainAccount>& chains) {
  std::int64_t by_us = 0;
  for (const ChainAccount& chain : chains) {
    if (chain.over_claim > 0) by_us = std::max(by_us, chain.over_us - chain.over_claimed_us);
    if (chain.urgent_exceeded)
      by_us = std::max(by_us, chain.longest_urgent_us - chain.urgent_worst_case_us);
  }
  return by_us;
}

}  // namespace

const char* to_string(Verdict verdict) {
  switch (verdict) {
    case Verdict::kNothingClaimed:
      return "nothing claimed";
    case Verdict::kKept:
      return "kept";
    case Verdict::kNotClaimed:
      return "not claimed";
    case Verdict::kExceeded:
      return "exceeded";
    case Verdict::kBothBroken:
      return "exceeded, not claimed";
  }
  return "";
}

bool Account::exceeded() const {
  return claims() && (change_exceeded || std::ranges::any_of(chains, &ChainAccount::exceeded));
}

bool Account::stands() const {
  return claims() && std::ranges::none_of(assumptions, &Assumption::broken);
}

std::vector<std::string> Account::broken() const {
  std::vector<std::string> lines;
  if (claims())
    for (const Assumption& one : assumptions)
      lines.insert(lines.end(), one.words.begin(), one.words.end());
  return lines;
}

Verdict Account::verdict() const {
  if (!claims()) return Verdict::kNothingClaimed;
  if (stands()) return exceeded() ? Verdict::kExceeded : Verdict::kKept;
  return exceeded() ? Verdict::kBothBroken : Verdict::kNotClaimed;
}

std::vector<std::string> Account::taken_from() const {
  std::vector<TakenReport> list = taken;
  std::ranges::stable_sort(list, std::greater<>(), &TakenReport::us);
  constexpr std::size_t kShown = 5;
  const std::int64_t least_us = std::min(kEmulatorUs, exceeded_by_us(chains));
  std::vector<std::string> lines;
  for (const TakenReport& one : list)
    if (one.us >= least_us && lines.size() < kShown) lines.push_back(one.what);
  if (lines.empty() && !not_watched.empty())
    lines.push_back("whether threads got their CPUs at once is not watched here (" + not_watched +
                    ")");
  if (goes_on) lines.emplace_back("what took time away from it is told when it ends");
  return lines;
}

std::string Account::verdict_words(Layout layout) const {
  const Verdict said = verdict();
  if (said == Verdict::kNothingClaimed)
    return why_nothing.empty() ? "nothing is claimed of this run" : why_nothing;
  if (said == Verdict::kKept) return "kept, as far as it is watched";
  const std::vector<std::string> why = said == Verdict::kExceeded ? taken_from() : broken();
  std::string text =
      said == Verdict::kNotClaimed   ? "not claimed here:"
      : said == Verdict::kBothBroken ? "exceeded, and not claimed here:"
      : why.empty()
          ? "exceeded, though nothing that is watched was broken; if nothing else used its "
            "GPUs and DLAs, which no run watches, and `xauto check` agrees to the policy, please "
            "report this run"
          : "exceeded; the app broke nothing that is watched, but:";
  const bool list = layout == Layout::kList && why.size() > 1;
  for (std::size_t i = 0; i < why.size(); ++i)
    text += (list ? "\n    - " : i == 0 ? " " : "; ") + why[i];
  return text;
}

std::string Account::words(Layout layout) const {
  std::string text =
      claims() ? "worst cases of " + scope + ": " + verdict_words(layout) : verdict_words(layout);
  if (!claims()) return text;
  constexpr std::size_t kShown = 3;
  std::size_t number = 0;
  const char* between = layout == Layout::kList ? "\n    " : "; ";
  for (const ChainAccount& chain : chains)
    if (chain.over_claim > 0 && ++number <= kShown)
      text += fmt::format(
          "{}chain '{}': {} result{} longer than claimed, the worst {:.2f} ms of {:.2f} ms",
          between, chain.name, chain.over_claim, chain.over_claim == 1 ? "" : "s",
          static_cast<double>(chain.over_us) / 1000,
          static_cast<double>(chain.over_claimed_us) / 1000);
  if (number > kShown) text += fmt::format("{}{} chains more", between, number - kShown);
  return text;
}

void Account::add(std::string_view kind, std::uint64_t count, std::vector<std::string> words) {
  const auto at = std::ranges::find(assumptions, kind, &Assumption::kind);
  if (at == assumptions.end()) {
    assumptions.push_back({std::string(kind), count, std::move(words)});
    return;
  }
  at->count = std::max(at->count, count);
  if (at->words.empty()) at->words = std::move(words);
}

void Account::add(std::string_view kind, std::uint64_t count, const std::string& words) {
  std::vector<std::string> lines;
  if (!words.empty()) lines.push_back(words);
  add(kind, count, std::move(lines));
}

std::uint64_t Account::count_of(std::string_view kind) const {
  const auto at = std::ranges::find(assumptions, kind, &Assumption::kind);
  return at == assumptions.end() ? 0 : at->count;
}

void claim_on(Account& account, Claimed claimed) {
  switch (claimed) {
    case Claimed::kNothing:
      return;
    case Claimed::kOfRates:
      account.scope = kKeyScope;
      return;
    case Claimed::kOneAtATime:
      account.scope = kOneAtATimeScope;
      return;
    case Claimed::kUncertified:
      account.why_nothing = kNotCertified;
  }
}

Json quantiles_json(const Distribution& us) {
  if (us.count() == 0) return {{"p50", Json()}, {"p99", Json()}, {"max", Json()}};
  return {{"p50", us.quantile(0.5)},
          {"p99", us.count() < kLeastOfP99 ? Json() : Json(us.quantile(0.99))},
          {"max", us.max()}};
}

Json claims_json(const Account& account) {
  Json assumptions = Json::array(), taken = Json::array();
  for (const Assumption& one : account.assumptions)
    if (one.count > 0 || one.broken())
      assumptions.push_back({{"kind", one.kind}, {"count", one.count}, {"broken", one.broken()}});
  for (const TakenReport& of : account.taken) taken.push_back({{"what", of.what}, {"us", of.us}});
  Json json = {{"verdict", to_string(account.verdict())},
               {"exceeded", account.exceeded()},
               {"broken", account.broken()},
               {"assumptions", std::move(assumptions)}};
  if (account.claims()) json["of"] = account.scope;
  if (account.goes_on) return json;
  json["time_taken"] = std::move(taken);
  if (!account.not_watched.empty()) json["not_watched"] = account.not_watched;
  return json;
}

Json chain_json(const ChainAccount& chain) {
  Json json = {{"name", chain.name},
               {"results", chain.results()},
               {"lost", chain.lost},
               {"latency_us", quantiles_json(chain.latency_us)},
               {"age_us", quantiles_json(chain.age_us)}};
  if (!chain.from.empty()) {
    json["from"] = chain.from;
    json["to"] = chain.to;
  }
  if (chain.deadline_us > 0) {
    json["deadline_us"] = chain.deadline_us;
    json["deadline_misses"] = chain.deadline_misses;
  }
  if (chain.max_age_us > 0) {
    json["max_age_us"] = chain.max_age_us;
    json["age_misses"] = chain.age_misses;
  }
  if (chain.worst_case_us > 0) {
    json["worst_case_us"] = chain.worst_case_us;
    json["exceeded"] = chain.exceeded();
    json["longer_than_claimed"] = chain.over_claim;
  }
  if (chain.over_claim > 0)
    json["exceeded_by"] = {{"latency_us", chain.over_us}, {"worst_case_us", chain.over_claimed_us}};
  if (chain.lower_bound_us > 0) json["lower_bound_us"] = chain.lower_bound_us;
  if (chain.urgent_worst_case_us > 0) json["urgent_worst_case_us"] = chain.urgent_worst_case_us;
  if (chain.urgent_us.count() > 0) {
    json["urgent_results"] = chain.urgent_us.count();
    json["urgent_us"] = quantiles_json(chain.urgent_us);
  }
  if (chain.not_measured > 0) json["not_measured"] = chain.not_measured;
  return json;
}

}  // namespace xauto::runtime
