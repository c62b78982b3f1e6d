// SPDX-License-Identifier: Apache-2.0
// What the profiler runs the app on: one release after the other, from the recording or from the app's
// own sources.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include <xauto/result.h>

#include "base/thread_safety.h"
#include "graph/app_spec.h"
#include "graph/graph.h"
#include "graph/inlet.h"
#include "record/recording.h"
#include "session/session.h"

namespace xauto::runtime {

using Messages = std::vector<std::shared_ptr<const void>>;  ///< [topic]

/// Threads: one. What it is made of outlives it.
class ProfileInput {
 public:
  /// Errors: the recording cannot be read, or has no messages for a source.
  [[nodiscard]] static Result<ProfileInput> open(const detail::AppSpecErased& app,
                                                 const Graph& graph, const Session& session,
                                                 detail::Inlets& inlets);
  /// A message for each source into `messages`. False: the recording has ended. Errors: kTimeout where
  /// nobody publishes for a pushed source.
  [[nodiscard]] Result<bool> next(Messages& messages);

 private:
  ProfileInput(const detail::AppSpecErased& app, const Graph& graph, detail::Inlets& inlets)
      : app_(&app), graph_(&graph), inlets_(&inlets) {}
  [[nodiscard]] Status wait_for_pushed(Messages& messages);

  OneThread thread_;
  const detail::AppSpecErased* app_;
  const Graph* graph_;
  detail::Inlets* inlets_;
  std::optional<record::Recording> recording_;
  std::uint64_t sequence_ = 0;
};

}  // namespace xauto::runtime
