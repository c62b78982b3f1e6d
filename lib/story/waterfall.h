// SPDX-License-Identifier: Apache-2.0
// One release as a waterfall: its whole time in one bar, a row for each job on its way, and who had the XPUs
// meanwhile.
#pragma once

#include <string>

#include "story/chain_story.h"
#include "story/trace_reader.h"

namespace xauto::story {

/// HTML. Jobs from before the release, whose results were read, are shown from then on only.
[[nodiscard]] std::string waterfall(const ReadTrace& trace, const TraceReactions::One& release,
                                    const ChainStory& story);

/// The class of a stretch in page.css.
[[nodiscard]] const char* css_class(SpentOn on);

}  // namespace xauto::story
