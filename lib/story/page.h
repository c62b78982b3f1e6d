// SPDX-License-Identifier: Apache-2.0
// What one or more runs did, as a page that needs neither network nor script: what became of the claims, a panel per
// chain, what each XPU did, changes of the scenario. It is made of traces alone, so a run's own page and one that is
// made of its trace later are the same.
#pragma once

#include <string>
#include <vector>

#include "story/trace_reader.h"

namespace xauto::story {

struct PagedRun {
  std::string file;  ///< of the trace, relative to the page; empty: it was not kept
  ReadTrace trace;
};

/// The whole page. Names are escaped. Pure.
[[nodiscard]] std::string page_html(const std::vector<PagedRun>& runs);

}  // namespace xauto::story
