// SPDX-License-Identifier: Apache-2.0
// The program of an app, to be filled in.
#pragma once

#include <string>
#include <vector>

#include <xauto/result.h>

#include "model/imported.h"

namespace xauto::import {

struct SkeletonFile {
  std::string name, text;
};

/// A folder that compiles with the installed library: each XNode is a function to fill in, and until then keeps an
/// emulated XPU busy for as long as the trace says, or 60 to 95 % of its WCET, less of a short one, where there is none.
/// `version`: of find_package(xauto ...), "0.2". Errors: no program has such edges or samples (tools/standin/main.cc
/// says which).
[[nodiscard]] Result<std::vector<SkeletonFile>> skeleton(const ImportedApp& imported,
                                                         const std::string& version);

}  // namespace xauto::import
