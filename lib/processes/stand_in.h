// SPDX-License-Identifier: Apache-2.0
// Stands in, in the hub, for the modules of a process that died: what comes to them is lost, once
// for every release, and told downstream with tombstones, so that nobody waits for it.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <vector>

#include "processes/hub.h"
#include "transport/receiver.h"

namespace xauto::runtime {

/// Threads: built on one, then `arrive` on the hub's receiver only.
class StandIn {
 public:
  /// Release `sequence` of `module` is lost.
  using Lose = std::function<void(int module, std::uint64_t sequence)>;

  /// Takes over the modules of `process`: settles what it left behind, then reads its queues.
  [[nodiscard]] static Result<std::unique_ptr<StandIn>> take_over(int process, const Plan& plan,
                                                                  const Graph& graph, Hub& hub,
                                                                  transport::Receiver& receiver,
                                                                  Lose lose);

 private:
  StandIn(const Plan& plan, const Graph& graph, Hub& hub, Lose lose)
      : plan_(plan), graph_(graph), hub_(hub), lose_(std::move(lose)) {}
  /// Everything up to `sequence` will not be done by `module`.
  void arrive(int module, std::uint64_t sequence);
  void tombstone(int module, std::uint64_t sequence);
  /// Its modules that `topic` fires.
  template <class Each>
  void each_reader(std::size_t topic, Each each) const {
    for (const Graph::Subscriber& s : graph_.topics[topic].subscribers)
      if (!s.sampled && plan_.process_of[static_cast<std::size_t>(s.module)] == process_)
        each(s.module);
  }

  const Plan& plan_;
  const Graph& graph_;
  Hub& hub_;
  Lose lose_;
  int process_ = 0;
  std::vector<std::shared_ptr<transport::Publisher>> publishers_;  ///< [topic]
  std::vector<std::unique_ptr<BoardRinger>> ringers_;
};

}  // namespace xauto::runtime
