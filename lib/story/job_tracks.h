// SPDX-License-Identifier: Apache-2.0
// What a trace file has of a run with sources beside the tracks of every run (run_trace.h): chains,
// windows, what was sampled. docs/timeline.md has the picture.
#pragma once

#include <cstdint>
#include <vector>

#include "story/perfetto.h"
#include "story/reactions.h"
#include "story/run_trace.h"

namespace xauto::story {

/// A slice for each release of each chain's source, until the chain's end knew of it.
void paint_chains(PerfettoWriter& out, PerfettoWriter::Track root, const AppSpec& app,
                  const Scene& scene, const Story& story);

/// Under what ran on row `row`, whose track it is: a slice for each job, from when it might begin to
/// its key.
void paint_windows(PerfettoWriter& out, PerfettoWriter::Track track, int row, const AppSpec& app,
                   const Scene& scene, const Story& story);

/// An instant for each message that was sampled. `arrows`: [activation][sample] those that end and
/// begin there.
void paint_samples(PerfettoWriter& out, PerfettoWriter::Track root, const AppSpec& app,
                   const Scene& scene, const Story& story,
                   std::vector<std::vector<PerfettoWriter::Details>> arrows);

/// What the first and the last slice of a job say of its window.
void tell_window(const ObservedWindow& window, std::int64_t began_ns,
                 PerfettoWriter::Details& first);
void tell_lateness(const ObservedWindow& window, std::int64_t ended_ns,
                   PerfettoWriter::Details& last);

}  // namespace xauto::story
