// SPDX-License-Identifier: Apache-2.0
#include "runtime/held_up.h"

#include <algorithm>

#include "base/log.h"
#include "model/contention.h"

namespace xauto::runtime {

HeldUp::HeldUp(const Context& context, const Placing& placing)
    : graph_(context.graph),
      by_keys_(context.session.keys.has_value()),
      xpus_(context.session.platform.xpus.size()),
      xnode_(placing.xnode),
      wcet_ns_(context.session.num_tables() * context.session.app.xnodes.size()) {
  const Session& session = context.session;
  for (const XNodeSpec& xnode : session.app.xnodes) names_.push_back(xnode.name);
  for (std::size_t t = 0; t < placing.xpu.size(); ++t)
    for (std::size_t n = 0; n < placing.xpu[t].size(); ++n) {
      if (placing.xpu[t][n] < 0) continue;
      const auto at = static_cast<std::size_t>(placing.xpu[t][n]);
      const Xpu& xpu = session.platform.xpus[at];
      wcet_ns_[session.task(t, xnode_[n])] =
          (by_keys_ && !session.tables
               ? counted_wcet_us(session.app, session.platform, *session.keys, xnode_[n])
               : wcet_of(session.app.xnodes[xnode_[n]], session.variant_of(t, xnode_[n]), xpu.type)
                     .value_or(0)) *
          1000;
      const auto address = session.coordinators.find(xpu.id);
      if (xpus_[at] || address == session.coordinators.end()) continue;
      auto observer = coord::Observer::connect(address->second);
      if (observer)
        xpus_[at] = std::move(*observer);
      else
        log::debug("who is held up on {} is not seen: {}", xpu.id, observer.error().to_string());
    }
}

/// [XNode] on a way from `node`, by edges and samples.
std::vector<char> HeldUp::after(int node) const {
  std::vector<char> later(names_.size(), 0), seen(graph_.nodes.size(), 0);
  std::vector<int> todo{node};
  while (!todo.empty()) {
    const int from = todo.back();
    todo.pop_back();
    for (const auto* pairs : {&graph_.edges, &graph_.samples})
      for (const auto& [u, v] : *pairs) {
        if (u != from || v == node || seen[static_cast<std::size_t>(v)] != 0) continue;
        seen[static_cast<std::size_t>(v)] = 1;
        later[xnode_[static_cast<std::size_t>(v)]] = 1;
        todo.push_back(v);
      }
  }
  return later;
}

HeldUp::Watch::Watch(const HeldUp& all, int node, std::int64_t now_ns)
    : all_(all), node_(node), looked_ns_(now_ns) {}

HeldUp::Watch::Sight& HeldUp::Watch::sight(std::size_t xpu, const coord::Observer::Running& job) {
  for (Sight& s : sights_)
    if (s.xpu == xpu && s.slot == job.slot && s.generation == job.generation) return s;
  return sights_.emplace_back(Sight{xpu, job.slot, job.generation, -1, true});
}

std::optional<HeldUp::Waits> HeldUp::Watch::look(std::int64_t now_ns, coord::Key key) {
  if (later_.empty()) later_ = all_.after(node_);
  const std::int64_t passed_ns = std::min(now_ns - looked_ns_, 2 * kHeldUpLookNs);
  looked_ns_ = now_ns;
  for (Sight& s : sights_) s.still = false;
  std::optional<Waits> first;
  for (std::size_t x = 0; x < all_.xpus_.size(); ++x) {
    const coord::Observer* observer = all_.xpus_[x].get();
    if (observer == nullptr) continue;
    const bool unseen = observer->discipline() == Discipline::kKernel;
    running_.clear();
    observer->running(running_);
    for (const coord::Observer::Running& job : running_) {
      if (job.xnode >= all_.wcet_ns_.size()) continue;
      const auto xnode = static_cast<std::uint32_t>(job.xnode % later_.size());  // of a task
      if (later_[xnode] == 0 || job.key >= key) continue;
      Sight& s = sight(x, job);
      s.still = true;
      s.ran_ns = s.ran_ns < 0 ? 0 : s.ran_ns + passed_ns;
      if (s.ran_ns <= held_up_after_ns(all_.wcet_ns_[job.xnode])) continue;
      if (unseen && (!all_.by_keys_ || now_ns <= job.key)) continue;
      if (!first || job.key < first->key) first = Waits{xnode, job.key};
    }
  }
  std::erase_if(sights_, [](const Sight& s) { return !s.still; });
  return first;
}

}  // namespace xauto::runtime
