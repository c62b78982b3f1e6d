// SPDX-License-Identifier: Apache-2.0
// A chain on the page: a dot for each release under each policy, beside deadline, claim and bound; then of each run
// the slowest release and one of the median, with where its time went.
#pragma once

#include <string>
#include <vector>

#include "story/page.h"

namespace xauto::story {

/// All chains of the runs, in the order of their first mention.
[[nodiscard]] std::vector<std::string> chains_of(const std::vector<PagedRun>& runs);

[[nodiscard]] std::string chain_panel(const std::string& chain, const std::vector<PagedRun>& runs);

/// "XAuto", of a trace whose title is "driving on small: XAuto".
[[nodiscard]] std::string policy_of(const ReadTrace& trace);

/// What the colours of the panels mean.
[[nodiscard]] std::string legend();

}  // namespace xauto::story
