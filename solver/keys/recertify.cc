// SPDX-License-Identifier: Apache-2.0
#include "solver/keys/recertify.h"

#include <algorithm>

#include "solver/keys/certificate.h"

namespace xauto::solver::keys {

Recertifier::Recertifier(const Problem& p, const std::vector<int>& xpu, const Windows& w)
    : p_(p),
      xpu_(xpu),
      lanes_(at(p.num_xpus)),
      early_(at(p.num_xnodes)),
      number_(at(p.num_slots), -1) {
  charges_.preempts.assign(at(p.num_slots), 0);
  charges_.blocked_by.assign(at(p.num_slots), 0);
  charges_.last_start.assign(at(p.num_slots), kForever);
  charges_.urgent_preempts.assign(at(p.num_xnodes), 0);
  const std::vector<char> shared = shared_xpus(p, xpu);
  for (int i = 0; i < p.num_xnodes; ++i) {
    lanes_[at(xpu[at(i)])].xnodes.push_back(i);
    early_[at(i)] = starts_of(p, w, w.e, i);
  }
  for (int m = 0; m < p.num_xpus; ++m) {
    Lane& lane = lanes_[at(m)];
    lane.shared = shared[at(m)] != 0;
    if (lane.xnodes.empty() || p.any_urgent || p.levels[at(m)] != kAnyLevels || p.beside_others(m))
      continue;
    lane.kind = p.preemptive[at(m)] != 0 && p.preempt[at(m)] > 0 ? Kind::kPays : Kind::kKeeps;
    if (lane.kind != Kind::kPays) continue;
    charge(p, xpu, w, urgent_, m, all_charges_);
    for (const int i : lane.xnodes)
      std::copy_n(all_charges_.preempts.begin() + p.slot[at(i)], p.jobs[at(i)],
                  charges_.preempts.begin() + p.slot[at(i)]);
    if (lane.shared) continue;
    Tick deepest = 0;
    for (const int i : lane.xnodes) deepest = std::max(deepest, early_[at(i)].deepest);
    const Domain& domain = p.domains[at(p.domain_of(lane.xnodes.front()))];
    lane.pad = drift_pad(deepest, domain.ppm);
    FittingAlone::Jobs jobs;
    for (const int i : lane.xnodes)
      for (int n = 0; n < p.jobs[at(i)]; ++n) {
        const std::size_t slot = at(p.slot[at(i)] + n);
        number_[slot] = static_cast<int>(jobs.size());
        jobs.emplace_back(number_[slot],
                          laid(p, w, i, n, m, charges_.preempts[slot] != 0, 0, lane.pad));
      }
    lane.alone.emplace(domain.hyper, jobs);
  }
}

bool Recertifier::still(const Windows& w, const std::vector<Was>& fallen) {
  if (p_.contended) {  // whom one meets, others on other XPUs meet as well
    Windows now = w;
    return certify(p_, xpu_, now);
  }
  if (p_.any_urgent) {
    derive_urgent(p_, xpu_, w, urgent_);
    if (int i = -1; urgent_shortfall(p_, xpu_, w, urgent_, i) > 0) return false;
  }
  paid_.clear();
  started_.clear();
  changed_.clear();
  for (Lane& lane : lanes_) lane.fallen.clear();
  for (const Was& was : fallen)
    lanes_[at(xpu_[at(p_.slot_xnode[at(was.slot)])])].fallen.push_back(was);
  for (int m = 0; m < p_.num_xpus; ++m)
    if (!keeps(m, w)) {
      take_back();
      return false;
    }
  return true;
}

bool Recertifier::keeps(int m, const Windows& w) {
  const Lane& lane = lanes_[at(m)];
  // Windows of urgent releases may move where nothing else does.
  if (lane.xnodes.empty() || (lane.fallen.empty() && !p_.any_urgent)) return true;
  switch (lane.kind) {
    case Kind::kKeeps:
      return true;
    case Kind::kPays:
      return pays_no_more(m, w);
    case Kind::kWhole:
      break;
  }
  charge(p_, xpu_, w, urgent_, m, all_charges_);
  return certify_xpu(p_, m, xpu_, lane.shared, w, urgent_, all_charges_);
}

bool Recertifier::pays_no_more(int m, const Windows& w) {
  Lane& lane = lanes_[at(m)];
  const std::size_t known = paid_.size();
  who_pays(m, w);
  if (!lane.alone) {
    const bool more =
        std::any_of(paid_.begin() + static_cast<std::ptrdiff_t>(known), paid_.end(),
                    [&](const auto& was) { return charges_.preempts[was.first] > was.second; });
    return !more || certify_xpu(p_, m, xpu_, lane.shared, w, urgent_, charges_);
  }
  std::vector<std::size_t> slots;
  for (const Was& was : lane.fallen)
    if (was.a != w.a[at(was.slot)]) slots.push_back(at(was.slot));
  for (std::size_t k = known; k < paid_.size(); ++k) slots.push_back(paid_[k].first);
  std::sort(slots.begin(), slots.end());
  slots.erase(std::unique(slots.begin(), slots.end()), slots.end());
  FittingAlone::Jobs jobs;
  for (const std::size_t s : slots) {
    const int i = p_.slot_xnode[s], n = static_cast<int>(s) - p_.slot[at(i)];
    jobs.emplace_back(number_[s], laid(p_, w, i, n, m, charges_.preempts[s] != 0, 0, lane.pad));
  }
  if (!lane.alone->change(jobs)) return false;
  changed_.push_back(m);
  return true;
}

void Recertifier::who_pays(int m, const Windows& w) {
  const Lane& lane = lanes_[at(m)];
  bool longer = false;
  for (const Was& was : lane.fallen) {
    const int j = p_.slot_xnode[at(was.slot)];
    const Tick e = w.e[at(was.slot)], length = w.d[at(was.slot)] - e;
    if (e == was.e) continue;
    Starts& of = early_[at(j)];
    longer = longer || length > of.longest;
    if (length <= of.longest && e >= of.least) continue;
    started_.emplace_back(j, of);
    of.longest = std::max(of.longest, length);
    of.least = std::min(of.least, e);
  }
  if (longer && lane.shared) {  // it may matter at any phase
    for (const int i : lane.xnodes)
      for (int n = 0; n < p_.jobs[at(i)]; ++n) look_at(lane, i, n, w);
    return;
  }
  for (const Was& was : lane.fallen)
    if (was.e != w.e[at(was.slot)]) look_at_those_ready_by(lane, was, w);
  for (const Was& was : lane.fallen) {
    const int i = p_.slot_xnode[at(was.slot)];
    if (was.a != w.a[at(was.slot)]) look_at(lane, i, was.slot - p_.slot[at(i)], w);
  }
}

/// One that is ready before the new start did not meet the job, and does not; one that is ready after the old start did.
void Recertifier::look_at_those_ready_by(const Lane& lane, const Was& was, const Windows& w) {
  const int j = p_.slot_xnode[at(was.slot)];
  const Component& cj = p_.components[at(p_.component_of[at(j)])];
  const Tick release = cj.phase + (was.slot - p_.slot[at(j)]) * cj.period;
  for (const int i : lane.xnodes) {
    if (i == j || are_apart(p_, i, j, lane.shared)) continue;
    const Component& ci = p_.components[at(p_.component_of[at(i)])];
    const Tick deepest = early_[at(i)].deepest;
    const Tick blur = lost_in(2 * deepest + early_[at(j)].deepest, p_.domains[at(ci.domain)].ppm);
    const Tick from = release + w.e[at(was.slot)] - deepest - blur - ci.phase;
    const Tick to = release + was.e + blur - ci.phase;
    const Pair pair(p_, w, w.e, early_[at(j)], i, j, lane.shared);
    for (Tick n = floor_div(from, ci.period); n <= floor_div(to, ci.period); ++n) {
      const std::size_t s = p_.slot_of(i, n);
      if (charges_.preempts[s] == 0 && pair.meets(static_cast<int>(s) - p_.slot[at(i)]))
        pays(s, true);
    }
  }
}

void Recertifier::look_at(const Lane& lane, int i, int n, const Windows& w) {
  const bool does = std::ranges::any_of(lane.xnodes, [&](int j) {
    return j != i && Pair(p_, w, w.e, early_[at(j)], i, j, lane.shared).meets(n);
  });
  pays(at(p_.slot[at(i)] + n), does);
}

void Recertifier::pays(std::size_t slot, bool does) {
  char& is = charges_.preempts[slot];
  if ((is != 0) == does) return;
  paid_.emplace_back(slot, is);
  is = does ? 1 : 0;
}

void Recertifier::take_back() {
  for (; !paid_.empty(); paid_.pop_back())
    charges_.preempts[paid_.back().first] = paid_.back().second;
  for (; !started_.empty(); started_.pop_back())
    early_[at(started_.back().first)] = started_.back().second;
  for (const int m : changed_) lanes_[at(m)].alone->undo();
  changed_.clear();
}

}  // namespace xauto::solver::keys
