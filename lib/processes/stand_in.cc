// SPDX-License-Identifier: Apache-2.0
#include "processes/stand_in.h"

namespace xauto::runtime {

Result<std::unique_ptr<StandIn>> StandIn::take_over(int process, const Plan& plan,
                                                    const Graph& graph, Hub& hub,
                                                    transport::Receiver& receiver, Lose lose) {
  auto stand_in = std::unique_ptr<StandIn>(new StandIn(plan, graph, hub, std::move(lose)));
  StandIn& g = *stand_in;
  g.process_ = process;
  g.publishers_.resize(graph.topics.size());
  for (std::size_t t = 0; t < graph.topics.size(); ++t) {
    const Plan::Remote& remote = plan.topics[t];
    if (remote.publisher != process || remote.readers.empty()) continue;
    g.ringers_.push_back(std::make_unique<BoardRinger>(hub.board(), remote.readers));
    XAUTO_ASSIGN(g.publishers_[t],
                 hub.topic(t).publisher(graph.topics[t].spec, g.ringers_.back().get()));
  }
  for (const int m : graph.module_order) {
    if (plan.process_of[static_cast<std::size_t>(m)] != process) continue;
    if (!graph.modules[static_cast<std::size_t>(m)].numbered) continue;
    // It may have died between settling a release and publishing it.
    const std::uint64_t settled = hub.board()->module(m).settled();
    if (settled > 0) g.tombstone(m, settled - 1);
  }
  // What it had taken out of its queues, nobody has any more. Told now: whoever waits for the end of
  // all that is in flight sends nothing after it.
  for (std::size_t t = 0; t < graph.topics.size(); ++t) {
    if (plan.topics[t].reader(process) < 0) continue;
    const std::uint64_t next = hub.topic(t).next_sequence();
    g.each_reader(t, [&](int m) {
      if (next > 0 && graph.modules[static_cast<std::size_t>(m)].numbered) g.arrive(m, next - 1);
    });
  }
  for (std::size_t t = 0; t < graph.topics.size(); ++t) {
    const int reader = plan.topics[t].reader(process);
    if (reader < 0) continue;
    XAUTO_ASSIGN(auto subscriber,
                 hub.topic(t).subscriber(graph.topics[t].spec, static_cast<std::uint32_t>(reader)));
    receiver.add(process, std::move(subscriber), true, [&g, t](const detail::Envelope& envelope) {
      g.each_reader(t, [&](int m) { g.arrive(m, envelope.sequence); });
    });
  }
  return stand_in;
}

void StandIn::arrive(int module, std::uint64_t sequence) {
  // Numbers of several sensors don't compare: counted, not passed on.
  if (!graph_.modules[static_cast<std::size_t>(module)].numbered) {
    lose_(module, sequence);
    return;
  }
  const ModuleLine& line = hub_.board()->module(module);
  if (sequence < line.settled()) return;
  while (line.settled() <= sequence) lose_(module, line.settled());
  tombstone(module, sequence);
}

void StandIn::tombstone(int module, std::uint64_t sequence) {
  for (const int t : graph_.modules[static_cast<std::size_t>(module)].outputs) {
    const auto& publisher = publishers_[static_cast<std::size_t>(t)];
    // One settles everything before it, so nothing is said twice.
    if (publisher != nullptr && publisher->next_sequence() <= sequence)
      publisher->publish({nullptr, 0, sequence});
    each_reader(static_cast<std::size_t>(t), [&](int m) { arrive(m, sequence); });
  }
}

}  // namespace xauto::runtime
