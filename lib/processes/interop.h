// SPDX-License-Identifier: Apache-2.0
// Topics that programs outside of the app hear or feed, as the deployment's `transport` says: what
// one process of the app has to do with them. docs/interop.md tells the rules.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "base/clock.h"
#include "graph/graph.h"
#include "processes/plan.h"
#include "session/session.h"
#include "transport/bridge.h"

namespace xauto::runtime {

/// Threads: one at a time, apart from what publishers are for.
class Interop {
 public:
  /// Null where this process has nothing to do with it. Errors: a topic that is not there or cannot
  /// be used so, no plug-in, no DDS.
  [[nodiscard]] static Result<std::unique_ptr<Interop>> open(const Graph& graph, const Plan& plan,
                                                             const Session& session);
  ~Interop();

  /// Where messages of `topic` go, too; null: nowhere.
  [[nodiscard]] transport::Publisher* publisher(std::size_t topic) const {
    return publishers_[topic].get();
  }
  /// Messages of this source's topic come from outside.
  [[nodiscard]] bool feeds(std::size_t topic) const { return feeds_[topic] != nullptr; }
  struct Taken {
    std::vector<detail::Envelope> messages;  ///< null: none came
    /// When the last of them was found, before it was decoded; nullopt: they lay there.
    std::optional<std::int64_t> came_ns;
  };
  /// The newest message of each of `topics` that was not taken yet. Waits until all have one, not
  /// beyond `until_ns` or a stop.
  [[nodiscard]] Taken take(const std::vector<int>& topics, std::int64_t until_ns,
                           const std::atomic<bool>& stop);
  /// Something has come for this source's topic that was not taken yet.
  [[nodiscard]] bool waits(std::size_t topic) const { return !feeds_[topic]->empty(); }
  /// The newest of it, with its stamp or arrival as origin; null: it is no message of that type.
  [[nodiscard]] detail::Envelope take(std::size_t topic);
  /// Returns when something comes, or at `until_ns`, and now and then without a reason; at once
  /// unless `nothing_to_do`.
  template <class NothingToDo>
  void wait(std::int64_t until_ns, NothingToDo nothing_to_do) {
    if (const std::int64_t left = until_ns - now_ns(); left > 0) arrived_.wait(nothing_to_do, left);
  }
  /// Ends it, after what waits has been sent.
  void stop();
  /// What went wrong; a line each.
  [[nodiscard]] std::vector<std::string> notes() const;

 private:
  Interop() = default;
  // First, so that it goes last.
  transport::Doorbell arrived_;
  std::unique_ptr<transport::Bridge> bridge_;
  std::vector<std::shared_ptr<transport::Publisher>> publishers_;  ///< [topic]
  std::vector<std::shared_ptr<transport::Subscriber>> feeds_;      ///< [topic]
  std::vector<std::string> names_;                                 ///< [topic]
  /// [topic] Taken, and replaced by a newer one before they were used.
  std::vector<std::atomic<std::uint64_t>> replaced_;
};

}  // namespace xauto::runtime
