// SPDX-License-Identifier: Apache-2.0
// Of a run, out of its events: how long each release took to become known at the end of
// each chain, and how each job lay in its window. Pure. The runtime counts the same by the origins
// that travel with messages (lib/account/routes.h); here it follows who has read what.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "model/app.h"
#include "model/policy.h"
#include "story/story.h"

namespace xauto::story {

/// From the nominal release of a chain's source to the end of the first job of its last XNode that
/// knows that release or a newer one.
struct Reaction {
  int chain = -1;  ///< index into AppSpec::chains
  std::int64_t number = 0;
  std::int64_t released_ns = 0, end_ns = 0;
  int job = -1;         ///< index into Story::jobs: the first that knows it
  bool urgent = false;  ///< the source marked it so, and the keys of its jobs moved forward
  [[nodiscard]] std::int64_t us() const { return (end_ns - released_ns) / 1000; }
};

/// By chain, then by number. What stems from a message whose origin the trace does not hold is left
/// out. Empty of an app without sources.
[[nodiscard]] std::vector<Reaction> reactions_of(const AppSpec& app, const Story& story);

/// When a job may run: from its nominal release and hold to its key, of an urgent release by as much
/// earlier as app.json says.
struct ObservedWindow {
  std::int64_t released_ns = 0, begin_ns = 0, key_ns = 0;
};
/// Nullopt: the trace does not tell its release.
[[nodiscard]] std::optional<ObservedWindow> window_of(const AppSpec& app, const Policy& keys,
                                                      const Story& story, const JobStory& job);

}  // namespace xauto::story
