// SPDX-License-Identifier: Apache-2.0
// WCETs that are above twice what is usual (XNodeSpec::typical_us): one spike of a profile may be all
// that an answer says. Where they decide it, solve names them.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "model/app.h"
#include "model/json_value.h"
#include "model/platform.h"
#include "solver/objectives.h"

namespace xauto::cli {

struct RareWcet {
  int xnode = -1;
  std::string type;
  std::int64_t wcet_us = 0, typical_us = 0;
};

/// Of the XNodes and types that `counts` takes.
[[nodiscard]] std::vector<RareWcet> rare_wcets(
    const AppSpec& app, const std::function<bool(int xnode, const std::string& type)>& counts);
/// Those that decide that no policy keeps up: at their typical times it is not proven.
[[nodiscard]] std::vector<RareWcet> rare_in_overload(const AppSpec& app, const Platform& platform,
                                                     const solver::Objectives& wishes);
/// Those that an answer rests on: `xpu` has the XPU of each XNode. They are on a way to what is late, or
/// beside it on an XPU; or a tenth of a worst case is theirs.
struct Way {
  std::vector<int> xnodes;
  std::int64_t worst_case_us = 0;
  bool late = false;
};
[[nodiscard]] std::vector<RareWcet> rare_in_policy(const AppSpec& app, const Platform& platform,
                                                   const std::vector<int>& xpu,
                                                   const std::vector<Way>& ways);

/// A paragraph; empty where there are none. `decide`: that they decide it has been shown.
[[nodiscard]] std::string words_of(const std::vector<RareWcet>& rare, const AppSpec& app,
                                   bool decide = true);
[[nodiscard]] Json to_json(const std::vector<RareWcet>& rare, const AppSpec& app);

}  // namespace xauto::cli
