// SPDX-License-Identifier: Apache-2.0
#include "solver/keys/holds.h"

#include <algorithm>

#include "solver/keys/chains.h"
#include "solver/keys/recertify.h"

namespace xauto::solver::keys {
namespace {

/// How often what is left of a hold is halved. Chosen.
constexpr int kHalvings = 4;

class Dropping {
 public:
  Dropping(const Problem& p, const std::vector<int>& xpu, Windows& w, const Until& until)
      : p_(p), xpu_(xpu), w_(w), until_(until), recertifier_(p, xpu, w), sooner_(at(p.num_xnodes)) {
    // By when jobs are ready but for their holds follows from keys, which stay.
    Windows free = w;
    std::ranges::fill(free.hold, 0);
    for (std::size_t d = 0; d < p.domains.size(); ++d)
      derive_ready(p, static_cast<int>(d), xpu, free);
    ready_ = std::move(free.a);
    for (const Chain& chain : p.chains)
      if (is_asked_for(p, chain)) asked_.push_back(asked_of(chain));
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
  /// A way of a chain, and who reads on it.
  struct Way {
    const Path* path;
    std::vector<int> readers;
    int leaves;  ///< the first component by it
    bool one_domain;
  };
  /// A chain whose worst case somebody asks for. Claims are in microseconds: of any release, and of an urgent one.
  struct Asked {
    const Chain* chain;
    bool may_be_urgent;
    Tick claim = 0, urgent_claim = 0;
    std::vector<Way> ways;
  };

  [[nodiscard]] Asked asked_of(const Chain& chain) const {
    Asked asked{
        &chain,
        std::ranges::any_of(p_.components,
                            [&](const Component& c) { return c.urgent_source == chain.source; }),
        0,
        0,
        {}};
    for (const Path& path : chain.paths) {
      Way way{&path,
              {},
              path.samples.empty() ? chain.to : p_.samples[at(path.samples.front())].first,
              true};
      for (const int s : path.samples) {
        way.readers.push_back(p_.samples[at(s)].second);
        way.one_domain =
            way.one_domain && p_.domain_of(way.readers.back()) == p_.domain_of(way.leaves);
      }
      asked.ways.push_back(std::move(way));
    }
    asked.claim = up_to_us(worst_case(p_, chain, w_));
    if (asked.may_be_urgent) asked.urgent_claim = up_to_us(worst_case(p_, chain, w_, true));
    return asked;
  }
  [[nodiscard]] Tick up_to_us(Tick t) const { return p_.up_to_us(std::max(Tick{0}, t)); }

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
    fallen_.clear();
    for (std::vector<Sooner>& sooner : sooner_) sooner.clear();
    // Pairs lead to other components; activations of one number belong together.
    for (const int i : p_.domains[at(p_.domain_of(xnode))].xnodes) {
      if (i != xnode && !p_.before(xnode, i)) continue;
      for (const int held : slots) {
        const int n = held - p_.slot[at(xnode)];
        const std::size_t s = at(p_.slot[at(i)] + n);
        const Recertifier::Was was{static_cast<int>(s), w_.a[s], w_.hold[s], w_.e[s]};
        if (i == xnode) w_.hold[s] = to(w_.hold[s]);
        w_.a[s] = std::max(ready_[s], w_.hold[s]);
        Tick e = w_.hold[s];
        for (const EdgeEnd& link : p_.pred[at(i)])
          if (p_.one_clock(xpu_[at(link.xnode)], xpu_[at(i)]))
            e = std::max(e, w_.e[p_.slot_of(link.xnode, n)]);
        w_.e[s] = e;
        if (e != was.e) sooner_[at(i)].push_back({n, was.e});
        if (e != was.e || w_.a[s] != was.a || w_.hold[s] != was.hold) fallen_.push_back(was);
      }
    }
    if (do_not_fall(xnode, slots) && is_claimed() && recertifier_.still(w_, fallen_)) return true;
    for (const Recertifier::Was& was : fallen_) {
      w_.a[at(was.slot)] = was.a;
      w_.hold[at(was.slot)] = was.hold;
      w_.e[at(was.slot)] = was.e;
    }
    return false;
  }

  [[nodiscard]] bool do_not_fall(int xnode, const std::vector<int>& slots) const {
    const Tick period = p_.period_of(xnode);
    const Tick apart = period - lost_in(period, p_.domains[at(p_.domain_of(xnode))].ppm);
    return std::ranges::all_of(slots, [&](int s) {
      const int n = s - p_.slot[at(xnode)];
      const Tick hold = w_.hold[at(s)];
      return w_.hold[p_.slot_of(xnode, n + 1)] + apart >= hold &&
             hold + apart >= w_.hold[p_.slot_of(xnode, n - 1)];
    });
  }

  /// Of no chain more than before.
  [[nodiscard]] bool is_claimed() {
    return std::ranges::all_of(asked_, [&](const Asked& asked) {
      return std::ranges::all_of(asked.ways, [&](const Way& way) {
        if (std::ranges::all_of(way.readers, [&](int v) { return sooner_[at(v)].empty(); }))
          return true;
        const auto of = [&](bool urgent, const Releases& releases) {
          return up_to_us(worst_case(p_, *asked.chain, *way.path, w_, urgent, releases));
        };
        if (asked.may_be_urgent || !way.one_domain)
          return of(false, {}) <= asked.claim &&
                 (!asked.may_be_urgent || of(true, {}) <= asked.urgent_claim);
        meet_readers(way, asked);
        return std::ranges::all_of(releases_, [&](const Releases& releases) {
          return of(false, releases) <= asked.claim;
        });
      });
    });
  }

  /// The releases of a way of one domain that may have come to a reader that starts sooner: its activation began after
  /// the release, and before the way's end.
  void meet_readers(const Way& way, const Asked& asked) {
    const Component& c = p_.components[at(p_.component_of[at(way.leaves)])];
    const std::int64_t ppm = p_.domains[at(c.domain)].ppm;
    releases_.clear();
    for (const int v : way.readers) {
      const Component& cv = p_.components[at(p_.component_of[at(v)])];
      // Where the clock drifts one activation or the next reads, and time is not quite the clock's; an urgent one
      // starts sooner.
      const Tick about = c.phase + asked.chain->offset + 2 * cv.period + p_.urgent_by(v) +
                         2 * lost_in(asked.claim + cv.period + c.phase, ppm);
      for (const Sooner& sooner : sooner_[at(v)]) {
        const Tick release = cv.phase + sooner.number * cv.period;
        const Tick from = release + w_.e[p_.slot_of(v, sooner.number)] - asked.claim - about;
        const Tick to = release + sooner.was + about;
        releases_.push_back(
            {floor_div(from - c.phase, c.period), floor_div(to - c.phase, c.period) + 1});
      }
    }
    std::ranges::sort(releases_, {}, &Releases::first);
    std::size_t kept = 0;
    for (const Releases& r : releases_)
      if (kept > 0 && r.first <= releases_[kept - 1].last + 1)
        releases_[kept - 1].last = std::max(releases_[kept - 1].last, r.last);
      else
        releases_[kept++] = r;
    releases_.resize(kept);
  }

  /// An activation, and when it started.
  struct Sooner {
    std::int64_t number;
    Tick was;
  };

  const Problem& p_;
  const std::vector<int>& xpu_;
  Windows& w_;
  Until until_;
  Recertifier recertifier_;
  std::vector<Tick> ready_;  ///< [slot] `a` but for the hold
  std::vector<Asked> asked_;
  // Of one change.
  std::vector<Recertifier::Was> fallen_;
  std::vector<std::vector<Sooner>> sooner_;  ///< [xnode]
  std::vector<Releases> releases_;
};

}  // namespace

void drop_holds(const Problem& p, const std::vector<int>& xpu, Windows& w, const Until& until) {
  Dropping(p, xpu, w, until).run();
}

}  // namespace xauto::solver::keys
