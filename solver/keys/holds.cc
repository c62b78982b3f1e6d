// SPDX-License-Identifier: Apache-2.0
#include "solver/keys/holds.h"

#include <algorithm>

#include "solver/keys/certificate.h"
#include "solver/keys/chains.h"

namespace xauto::solver::keys {
namespace {

/// How often what is left of a hold is halved. Chosen.
constexpr int kHalvings = 4;

class Dropping {
 public:
  Dropping(const Problem& p, const std::vector<int>& xpu, Windows& w, const Until& until)
      : p_(p), xpu_(xpu), w_(w), until_(until), shared_(shared_xpus(p, xpu)) {
    // By when jobs are ready but for their holds follows from keys, which stay.
    Windows free = w;
    std::ranges::fill(free.hold, 0);
    for (std::size_t d = 0; d < p.domains.size(); ++d)
      derive_ready(p, static_cast<int>(d), xpu, free);
    ready_ = std::move(free.a);
    for (const Chain& chain : p.chains) {
      claims_.push_back(claims_of(chain));
      std::vector<char>& reads = reads_.emplace_back(at(p.num_xnodes), 0);
      for (const Path& path : chain.paths)
        for (const int s : path.samples) reads[at(p.samples[at(s)].second)] = 1;
    }
  }

  void run() {
    bool shortened = false;
    for (bool changed = true; changed && !until_.over();) {
      changed = false;
      for (const int i : longest_first()) changed = drop(slots_of(i)) || changed;
      if (changed || shortened) continue;
      shortened = true;
      for (const int i : longest_first()) changed = shorten(slots_of(i)) || changed;
    }
  }

 private:
  /// In microseconds, as they are claimed: of any release, and of an urgent one.
  [[nodiscard]] std::pair<Tick, Tick> claims_of(const Chain& chain) const {
    const auto claim = [&](bool urgent) {
      return p_.up_to_us(std::max(Tick{0}, worst_case(p_, chain, w_, urgent)));
    };
    const bool may_be_urgent = std::ranges::any_of(
        p_.components, [&](const Component& c) { return c.urgent_source == chain.source; });
    return {claim(false), may_be_urgent ? claim(true) : 0};
  }

  [[nodiscard]] std::vector<int> slots_of(int xnode) const {
    std::vector<int> slots;
    for (int s = p_.slot[at(xnode)]; s < p_.slot[at(xnode)] + p_.jobs[at(xnode)]; ++s)
      if (w_.hold[at(s)] > 0) slots.push_back(s);
    return slots;
  }

  /// XNodes that are held.
  [[nodiscard]] std::vector<int> longest_first() const {
    std::vector<std::pair<Tick, int>> held;
    for (int i = 0; i < p_.num_xnodes; ++i) {
      const auto first = w_.hold.begin() + p_.slot[at(i)];
      const Tick longest = *std::max_element(first, first + p_.jobs[at(i)]);
      if (longest > 0) held.emplace_back(-longest, i);
    }
    std::ranges::sort(held);
    std::vector<int> xnodes;
    for (const auto& [longest, i] : held) xnodes.push_back(i);
    return xnodes;
  }

  /// All of them, or else each half by itself. True: some went.
  bool drop(const std::vector<int>& slots) {
    if (slots.empty() || until_.over()) return false;
    if (change(slots, [](Tick) { return Tick{0}; })) return true;
    if (slots.size() == 1) return false;
    const auto middle = slots.begin() + static_cast<std::ptrdiff_t>(slots.size() / 2);
    const bool first = drop({slots.begin(), middle});
    return drop({middle, slots.end()}) || first;
  }

  /// By halves of what they were, as long as that is certified; then by halves of that.
  bool shorten(const std::vector<int>& slots) {
    bool any = false;
    std::vector<Tick> was;
    for (const int s : slots) was.push_back(w_.hold[at(s)]);
    Tick kept = Tick{1} << kHalvings, tried = kept / 2;  // of 2^kHalvings parts
    for (Tick part = kept / 2; part > 0 && !until_.over(); part /= 2) {
      tried = kept - part;
      std::size_t k = 0;
      if (!change(slots,
                  [&](Tick) { return (was[k++] * tried >> kHalvings) / p_.scale * p_.scale; }))
        continue;
      kept = tried;
      any = true;
    }
    return any;
  }

  /// Whether holds of one XNode may become these. If not, they are as they were.
  template <class To>
  bool change(const std::vector<int>& slots, const To& to) {
    const int xnode = p_.slot_xnode[at(slots.front())];
    before_.clear();
    const auto save = [&](int i) {
      for (int s = p_.slot[at(i)]; s < p_.slot[at(i)] + p_.jobs[at(i)]; ++s)
        before_.push_back({s, w_.a[at(s)], w_.hold[at(s)], w_.e[at(s)]});
    };
    save(xnode);
    for (const int s : slots) w_.hold[at(s)] = to(w_.hold[at(s)]);
    std::vector<char> touched(at(p_.num_xpus), 0), sooner(at(p_.num_xnodes), 0);
    // Pairs lead to other components.
    for (const int i : p_.domains[at(p_.domain_of(xnode))].xnodes) {
      if (i != xnode && !p_.before(xnode, i)) continue;
      if (i != xnode) save(i);
      for (int n = 0; n < p_.jobs[at(i)]; ++n) {
        const std::size_t s = at(p_.slot[at(i)] + n);
        const Tick a = std::max(ready_[s], w_.hold[s]);
        Tick e = w_.hold[s];
        for (const EdgeEnd& link : p_.pred[at(i)])
          if (p_.one_clock(xpu_[at(link.xnode)], xpu_[at(i)]))
            e = std::max(e, w_.e[p_.slot_of(link.xnode, n)]);
        if (e != w_.e[s]) sooner[at(i)] = 1;
        if (e != w_.e[s] || a != w_.a[s]) touched[at(xpu_[at(i)])] = 1;
        w_.a[s] = a;
        w_.e[s] = e;
      }
    }
    if (do_not_fall(xnode) && is_claimed(sooner) && is_certified(touched)) return true;
    for (const Before& b : before_) {
      w_.a[at(b.slot)] = b.a;
      w_.hold[at(b.slot)] = b.hold;
      w_.e[at(b.slot)] = b.e;
    }
    return false;
  }

  [[nodiscard]] bool do_not_fall(int xnode) const {
    const Tick period = p_.period_of(xnode);
    const Tick apart = period - lost_in(period, p_.domains[at(p_.domain_of(xnode))].ppm);
    for (int n = 0; n < p_.jobs[at(xnode)]; ++n)
      if (w_.hold[p_.slot_of(xnode, n + 1)] + apart < w_.hold[p_.slot_of(xnode, n)]) return false;
    return true;
  }

  [[nodiscard]] bool is_claimed(const std::vector<char>& sooner) const {
    for (std::size_t c = 0; c < p_.chains.size(); ++c) {
      if (!is_asked_for(p_, p_.chains[c])) continue;
      bool reads = false;
      for (std::size_t i = 0; i < sooner.size(); ++i)
        reads = reads || (sooner[i] != 0 && reads_[c][i] != 0);
      if (!reads) continue;
      const auto [any, urgent] = claims_of(p_.chains[c]);
      if (any > claims_[c].first || urgent > claims_[c].second) return false;
    }
    return true;
  }

  bool is_certified(const std::vector<char>& touched) {
    if (p_.contended) {  // whom one meets, others on other XPUs meet as well
      Windows now = w_;
      return certify(p_, xpu_, now);
    }
    if (p_.any_urgent) {
      derive_urgent(p_, xpu_, w_, urgent_);
      if (int i = -1; urgent_shortfall(p_, xpu_, w_, urgent_, i) > 0) return false;
    }
    for (int m = 0; m < p_.num_xpus; ++m) {
      // Windows of urgent releases may move where nothing else does.
      if (touched[at(m)] == 0 && !p_.any_urgent) continue;
      charge(p_, xpu_, w_, urgent_, m, charges_);
      if (!certify_xpu(p_, m, xpu_, shared_[at(m)] != 0, w_, urgent_, charges_)) return false;
    }
    return true;
  }

  struct Before {
    int slot;
    Tick a, hold, e;
  };

  const Problem& p_;
  const std::vector<int>& xpu_;
  Windows& w_;
  Until until_;
  std::vector<char> shared_;                   ///< [xpu]
  std::vector<Tick> ready_;                    ///< [slot] `a` but for the hold
  std::vector<std::pair<Tick, Tick>> claims_;  ///< [chain]
  std::vector<std::vector<char>> reads_;       ///< [chain][xnode] it is a reader on some way
  std::vector<Before> before_;
  Windows urgent_;
  Charges charges_;
};

}  // namespace

void drop_holds(const Problem& p, const std::vector<int>& xpu, Windows& w, const Until& until) {
  Dropping(p, xpu, w, until).run();
}

}  // namespace xauto::solver::keys
