// SPDX-License-Identifier: Apache-2.0
#include "solver/keys/handover.h"

#include <algorithm>

#include "solver/keys/chains.h"
#include "solver/keys/handover_walk.h"

namespace xauto::solver::keys {
namespace {

using handover::Unchanged;
using handover::Walk;

/// What a way does on one clock.
struct Part {
  std::size_t chain, way;
  int begins;                ///< the first XNode that it leaves a component by, or is sampled by
  bool first;                ///< from the release of the chain's source on
  std::vector<int> samples;  ///< within the clock
  int ends;                  ///< an XNode
  Tick unchanged = 0;        ///< of the first table alone, in the clock's time
  Tick worst = 0;            ///< likewise, whatever happens
};

/// Whether activation n of `v` starts when activation k of `u` has certainly ended.
template <class Times>
bool reads(const Problem& p, const Times& times, int u, std::int64_t k, int v, std::int64_t n) {
  if (times.held(v, n) >= times.ends(u, k)) return true;
  const std::optional<Tick> key = times.key(u, k);
  // Where keys are kept, both are counted in real time: only the releases' distance drifts.
  return key && least_distance(times.release(v, n) - times.release(u, k),
                               p.domains[at(p.domain_of(v))].ppm) +
                        times.hold(v, n) >=
                    *key;
}

/// Its length in the clock's time, from release k of the source on, or if its first reader just misses at
/// release k - 1 what it reads at k. As chains.h follows it.
template <class Times>
Tick follow(const Problem& p, const Part& part, const Times& times, std::int64_t k) {
  const Component& c = p.components[at(p.component_of[at(part.begins)])];
  const Tick begin = part.first
                         ? times.release(part.begins, k) - c.phase + p.chains[part.chain].offset
                         : times.held(part.begins, k - 1);
  std::int64_t n = k;
  for (const int s : part.samples) {
    const auto [u, v] = p.samples[at(s)];
    const Component& cv = p.components[at(p.component_of[at(v)])];
    const Tick sooner = times.ends(u, n) - 2 * lost_in(times.ends(u, n) - times.release(u, n),
                                                       p.domains[at(cv.domain)].ppm);
    std::int64_t by = floor_div(sooner - times.most_hold(v) - cv.phase, cv.period);
    while (!reads(p, times, u, n, v, by)) ++by;
    n = by;
  }
  return times.ends(part.ends, n) - begin;
}

/// [domain], of all chains.
std::vector<std::vector<Part>> parts_of(const Problem& p) {
  std::vector<std::vector<Part>> parts(p.domains.size());
  for (std::size_t c = 0; c < p.chains.size(); ++c)
    for (std::size_t way = 0; way < p.chains[c].paths.size(); ++way) {
      const std::vector<int>& samples = p.chains[c].paths[way].samples;
      Part part{c,    way, samples.empty() ? p.chains[c].to : p.samples[at(samples[0])].first,
                true, {},  -1};
      const auto close = [&](int ends) {
        part.ends = ends;
        parts[at(p.domain_of(ends))].push_back(part);
      };
      for (const int s : samples) {
        const auto [u, v] = p.samples[at(s)];
        if (p.domain_of(u) == p.domain_of(v)) {
          part.samples.push_back(s);
          continue;
        }
        close(u);
        part = {c, way, v, false, {}, -1};
      }
      close(p.chains[c].to);
    }
  return parts;
}

/// Why nothing follows for the domain; empty: something may.
std::string refuses(const HandoverInput& in, int d) {
  const Problem& p = in.now;
  if (p.any_urgent) return "releases may be urgent";
  if (p.domains[at(d)].part)
    return "clock '" + p.clock_name[at(p.domains[at(d)].clock)] + "' has too long a hyperperiod";
  // Of two clocks no phase is known, so no order of their jobs can be walked.
  std::vector<char> own(at(p.num_xpus), 0);
  for (const int i : p.domains[at(d)].xnodes)
    own[at(in.from_xpu[at(i)])] = own[at(in.to_xpu[at(i)])] = 1;
  for (int i = 0; i < p.num_xnodes; ++i)
    for (const int m : {in.from_xpu[at(i)], in.to_xpu[at(i)]})
      if (p.domain_of(i) != d && own[at(m)] != 0)
        return "clock '" + p.clock_name[at(p.domains[at(d)].clock)] + "' shares " +
               p.xpu_name[at(m)] + " with clock '" +
               p.clock_name[at(p.domains[at(p.domain_of(i))].clock)] + "'";
  return {};
}

/// Where t may be, in pieces: no key of the first table is inside of one.
std::vector<Tick> pieces(const HandoverInput& in, const Domain& domain, Tick since, Tick s) {
  const Problem& p = in.now;
  const Unchanged from{p, in.from, domain.ppm};
  std::vector<Tick> ends = {since, s};
  for (const int i : domain.xnodes) {
    const Component& c = p.components[at(p.component_of[at(i)])];
    for (std::int64_t n = floor_div(s - 1 - c.phase, c.period);; --n) {
      const Tick key = from.ends(i, n);
      if (key <= since) break;
      if (key < s) ends.push_back(key);
    }
  }
  std::sort(ends.begin(), ends.end());
  ends.erase(std::unique(ends.begin(), ends.end()), ends.end());
  return ends;
}

/// Of either table alone.
void follow_unchanged(const HandoverInput& in, const Domain& domain, std::vector<Part>& parts) {
  const Problem& p = in.now;
  const Unchanged from{p, in.from, domain.ppm}, to{p, in.to, domain.ppm};
  for (Part& part : parts) {
    for (int k = 0; k < p.jobs[at(part.begins)]; ++k) {
      part.unchanged = std::max(part.unchanged, follow(p, part, from, k));
      part.worst = std::max(part.worst, follow(p, part, to, k));
    }
    part.worst = std::max(part.worst, part.unchanged);
  }
}

/// All S and t of a domain. False: nothing follows.
bool walk_all(const HandoverInput& in, int d, std::int64_t most_jobs, const Until& until,
              std::vector<Part>& parts, Tick& settles) {
  const Problem& p = in.now;
  const Domain& domain = p.domains[at(d)];
  follow_unchanged(in, domain, parts);
  Walk walk(in, d);
  for (const auto& [s, last] : handover::releases_of(p, domain)) {
    const Tick since = last - in_fast_time(in.notice, domain.ppm);
    const std::vector<Tick> ends = pieces(in, domain, since, s);
    for (std::size_t e = 0; e + 1 < ends.size(); ++e) {
      if (!walk.run(s, ends[e], ends[e + 1], most_jobs) || until.over()) return false;
      settles = std::max(settles, walk.settles());
      for (Part& part : parts) {
        const Component& of = p.components[at(p.component_of[at(part.begins)])];
        // What the first table alone brings through by t meets nobody.
        const Tick longest = part.unchanged + walk.most_hold(part.begins);
        std::int64_t k = floor_div(ends[e] - longest - of.phase, of.period) - 1;
        const Tick end = walk.last_late() + (part.first ? 0 : of.period);
        for (; of.phase + k * of.period <= end; ++k)
          part.worst = std::max(part.worst, follow(p, part, walk, k));
      }
    }
  }
  return true;
}

}  // namespace

HandoverBound bound_handover(const HandoverInput& in, std::int64_t most_jobs, const Until& until) {
  const Problem& p = in.now;
  HandoverBound bound;
  std::vector<std::vector<Tick>> ways;  // [chain][way]
  for (const Chain& chain : p.chains) {
    bound.worst.push_back(std::max(worst_case(p, chain, in.from), worst_case(p, chain, in.to)));
    ways.emplace_back(chain.paths.size(), 0);
  }
  std::vector<std::vector<Part>> parts = parts_of(p);
  for (int d = 0; d < static_cast<int>(p.domains.size()); ++d) {
    std::string why = refuses(in, d);
    Tick settles = 0;
    if (why.empty() && !walk_all(in, d, most_jobs, until, parts[at(d)], settles))
      why = "clock '" + p.clock_name[at(p.domains[at(d)].clock)] +
            "' was not seen to settle, as far as jobs were looked at";
    const std::int64_t ppm = p.domains[at(d)].ppm;
    if (why.empty()) bound.settles = std::max(bound.settles, in_slow_time(settles, ppm));
    for (const Part& part : parts[at(d)]) {
      Tick& way = ways[part.chain][part.way];
      if (!why.empty())
        way = kNoTick;
      else if (way != kNoTick)
        way += in_slow_time(part.worst, ppm);
    }
    if (!why.empty()) bound.why_not.push_back(why);
  }
  for (std::size_t c = 0; c < ways.size(); ++c)
    for (const Tick way : ways[c])
      bound.worst[c] =
          way == kNoTick || bound.worst[c] == kNoTick ? kNoTick : std::max(bound.worst[c], way);
  return bound;
}

}  // namespace xauto::solver::keys
