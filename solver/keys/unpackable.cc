// SPDX-License-Identifier: Apache-2.0
#include "solver/keys/unpackable.h"

#include <algorithm>
#include <set>

#include "solver/packing.h"

namespace xauto::solver::keys {
namespace {

constexpr Time kWhole = Time{1} << 40;
/// Loads that are tried as grains; chosen. Of more, a sample.
constexpr std::size_t kMostGrains = 12;
/// Of the looks, those of each grain.
constexpr std::int64_t kGrainsShare = 16;
/// Assignments that are remembered as refuted.
constexpr std::size_t kMostKnown = 100'000;

class Packer {
 public:
  Packer(const Problem& p, std::vector<std::vector<int>> units) : p_(p), units_(std::move(units)) {
    takes_.assign(at(p.num_xnodes), 0);
    std::vector<Tick> slowest(at(p.num_xnodes), 0);
    for (int i = 0; i < p.num_xnodes; ++i)
      for (const int m : p.may_run[at(i)]) {
        const Tick c = p.wcet(i, m);
        takes_[at(i)] = takes_[at(i)] == 0 ? c : std::min(takes_[at(i)], c);
        slowest[at(i)] = std::max(slowest[at(i)], c);
      }
    for (std::size_t m = 0; m < p.modules.size(); ++m) tight_.push_back(!ends_in_time(m, slowest));
    any_tight_ = std::find(tight_.begin(), tight_.end(), 1) != tight_.end();
    for (const std::vector<int>& unit : units_)
      for (int m = 0; m < p.num_xpus; ++m) whole_.push_back(load_on(unit, m));
  }

  /// What is left to the search: `xnode` on `xpu`, and none of `apart` there.
  void restrict(int xnode, int xpu, const std::vector<int>& apart) {
    for (std::size_t u = 0; u < units_.size(); ++u)
      for (const int i : units_[u]) {
        for (int m = 0; i == xnode && m < p_.num_xpus; ++m)
          if (m != xpu) whole_[u * at(p_.num_xpus) + at(m)] = -1;
        if (std::find(apart.begin(), apart.end(), i) != apart.end())
          whole_[u * at(p_.num_xpus) + at(xpu)] = -1;
      }
    special_ = xpu;
  }

  /// Whether every assignment is refuted, by f of this grain, within so many looks.
  bool refutes(Time grain, std::int64_t looks, const Until& until) {
    looks_ = looks;
    until_ = until;
    load_ = whole_;
    for (Time& load : load_)
      if (load >= 0) load = packed(load, kWhole, grain);
    free_.assign(at(p_.num_xpus), packed_room(kWhole, grain));
    placed_.assign(units_.size(), 0);
    known_.clear();
    return refuted() && looks_ > 0;
  }

  /// [unit] the least of its loads.
  [[nodiscard]] std::vector<Time> least() const {
    std::vector<Time> least;
    for (std::size_t u = 0; u < units_.size(); ++u) {
      Time& of = least.emplace_back(-1);
      for (int m = 0; m < p_.num_xpus; ++m)
        if (const Time load = whole_[u * at(p_.num_xpus) + at(m)]; load >= 0)
          of = of < 0 ? load : std::min(of, load);
    }
    return least;
  }
  [[nodiscard]] bool any_tight() const { return any_tight_; }

 private:
  /// -1: it cannot be there.
  [[nodiscard]] Time load_on(const std::vector<int>& unit, int m) const {
    Time load = 0;
    for (const int i : unit) {
      if (!std::binary_search(p_.may_run[at(i)].begin(), p_.may_run[at(i)].end(), m)) return -1;
      load += static_cast<Time>(static_cast<__int128>(p_.wcet(i, m)) * kWhole / p_.period_of(i));
    }
    return load <= kWhole ? load : -1;
  }

  [[nodiscard]] bool ends_in_time(std::size_t module, const std::vector<Tick>& takes) const {
    const Module& m = p_.modules[module];
    const Tick period = p_.components[at(m.component)].period;
    return m.in_flight > kMostTicks / period ||
           std::all_of(m.entries.begin(), m.entries.end(),
                       [&](int e) { return span(p_, takes, m, e) <= m.in_flight * period; });
  }

  /// Where it fits: of XPUs that are alike the first.
  std::vector<int> fits(std::size_t unit) {
    std::vector<int> xpus;
    for (int m = 0; m < p_.num_xpus; ++m) {
      --looks_;
      const Time load = load_[unit * at(p_.num_xpus) + at(m)];
      if (load < 0 || load > free_[at(m)]) continue;
      if (std::none_of(xpus.begin(), xpus.end(), [&](int o) {
            return o != special_ && m != special_ && p_.xpu_place[at(o)] == p_.xpu_place[at(m)] &&
                   free_[at(o)] == free_[at(m)];
          }))
        xpus.push_back(m);
    }
    return xpus;
  }

  /// Who is left, and what is free at each place, in order.
  [[nodiscard]] std::vector<Time> state() const {
    std::vector<Time> state(placed_.begin(), placed_.end());
    for (const std::vector<int>& xpus : p_.place_xpus) {
      const auto begin = state.size();
      for (const int m : xpus)
        if (m != special_) state.push_back(free_[at(m)]);
      std::sort(state.begin() + static_cast<std::ptrdiff_t>(begin), state.end());
    }
    if (special_ >= 0) state.push_back(free_[at(special_)]);
    return state;
  }

  /// Whether no assignment of the units that are left suits those that are placed. True without a proof
  /// where no looks are left.
  bool refuted() {
    if (until_.over()) looks_ = 0;
    std::size_t next = units_.size();
    std::vector<int> where;
    Time most = 0, needed = 0, room = 0;
    for (const Time free : free_) room += free;
    for (std::size_t u = 0; u < units_.size(); ++u) {
      if (placed_[u] != 0) continue;
      std::vector<int> xpus = fits(u);
      if (xpus.empty() || looks_ <= 0) return true;
      Time least = kWhole;
      for (const int m : xpus) least = std::min(least, load_[u * at(p_.num_xpus) + at(m)]);
      needed += least;
      if (next == units_.size() || xpus.size() < where.size() ||
          (xpus.size() == where.size() && least > most)) {
        next = u;
        most = least;
        where = std::move(xpus);
      }
    }
    if (needed > room) return true;
    if (next == units_.size()) return false;
    std::vector<Time> now;
    if (!any_tight_) {
      now = state();
      if (known_.contains(now)) return true;
    }
    for (const int m : where)
      if (!refuted_with(next, m)) return false;
    if (!any_tight_ && known_.size() < kMostKnown) known_.insert(std::move(now));
    return true;
  }

  bool refuted_with(std::size_t unit, int m) {
    const Time load = load_[unit * at(p_.num_xpus) + at(m)];
    std::vector<Tick> before;
    for (const int i : units_[unit]) before.push_back(std::exchange(takes_[at(i)], p_.wcet(i, m)));
    placed_[unit] = 1;
    free_[at(m)] -= load;
    const bool in_time =
        !any_tight_ || std::all_of(units_[unit].begin(), units_[unit].end(), [&](int i) {
          const int module = p_.module_of[at(i)];
          return module < 0 || tight_[at(module)] == 0 || ends_in_time(at(module), takes_);
        });
    const bool refuted_so = !in_time || refuted();
    free_[at(m)] += load;
    placed_[unit] = 0;
    for (std::size_t k = 0; k < before.size(); ++k) takes_[at(units_[unit][k])] = before[k];
    return refuted_so;
  }

  const Problem& p_;
  const std::vector<std::vector<int>> units_;
  std::vector<Time> whole_, load_;  ///< [unit * xpus + xpu] -1: it cannot be there
  std::vector<Time> free_;          ///< [xpu]
  std::vector<char> placed_;        ///< [unit]
  std::vector<Tick> takes_;         ///< [xnode] where it is placed; else at least
  std::vector<char> tight_;         ///< [module] some assignment keeps an activation too long
  bool any_tight_ = false;
  std::set<std::vector<Time>> known_;  ///< states that are refuted
  std::int64_t looks_ = 0;
  Until until_;
  int special_ = -1;  ///< an XPU that is like no other
};

}  // namespace

std::optional<OverloadProof> prove_unpackable(const Problem& p, std::int64_t looks,
                                              const Until& until) {
  const std::vector<std::vector<int>> all = units(p);
  const auto once = static_cast<std::int64_t>(all.size()) * p.num_xpus;  // each at each
  if (once > looks) return std::nullopt;
  Packer packer(p, all);
  const std::vector<Time> least = packer.least();
  std::set<Time> grains;
  if (once <= looks / kGrainsShare) {
    grains.insert(kWhole / 2 + 1);
    for (std::size_t u = 0; u < least.size(); u += least.size() / kMostGrains + 1)
      if (5 * least[u] > kWhole) grains.insert(least[u]);  // smaller ones count nearly all
  }
  bool proven = std::any_of(grains.begin(), grains.end(), [&](Time grain) {
    return packer.refutes(grain, looks / kGrainsShare, until);
  });
  proven = proven || packer.refutes(0, looks, until);
  if (!proven) return std::nullopt;
  OverloadProof proof;
  proof.text = "XNodes are whole, and each way to place them asks for more than 100 % of an XPU";
  if (packer.any_tight()) proof.text += ", or keeps an activation in a module for too long";
  std::vector<std::pair<int, double>> shares;
  for (std::size_t u = 0; u < all.size(); ++u)
    for (const int i : all[u])
      shares.emplace_back(i, static_cast<double>(least[u]) / static_cast<double>(kWhole) /
                                 static_cast<double>(all[u].size()));
  keep_causes(std::move(shares), proof);
  return proof;
}

bool cannot_place(const Problem& p, int xnode, int xpu, const std::vector<int>& apart,
                  std::int64_t looks) {
  Packer packer(p, units(p));
  packer.restrict(xnode, xpu, apart);
  return packer.refutes(0, looks, {});
}

}  // namespace xauto::solver::keys
