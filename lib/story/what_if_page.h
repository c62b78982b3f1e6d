// SPDX-License-Identifier: Apache-2.0
// `xauto whatif` as a page: what each chain takes now, and under other plans.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace xauto::story {

/// One way to run the app, and one chain of it. Times in us.
struct WhatIfRow {
  std::string name;        ///< "with XAuto's keys"
  std::int64_t count = 0;  ///< releases
  std::int64_t median_us = 0;
  std::int64_t p99_us = -1;  ///< -1: there are too few
  std::int64_t longest_us = 0;
  std::optional<std::int64_t> claim_us = {};
};

struct WhatIfChain {
  std::string name;
  std::optional<std::int64_t> deadline_us = {};
  std::vector<WhatIfRow> rows;
};

/// How busy what is, under one way to run the app.
struct WhatIfLoad {
  std::string name;
  std::vector<std::pair<std::string, double>> parts;  ///< XPU or executor, part of its time
};

struct WhatIfPage {
  std::string title;
  std::vector<std::string> verdict;  ///< sentences
  std::vector<WhatIfChain> chains;
  std::vector<WhatIfLoad> loads;
  std::vector<std::string> todo;
  std::string assumes;  ///< what the claims take for granted
};

/// It needs neither network nor script. Pure.
[[nodiscard]] std::string what_if_html(const WhatIfPage& page);

}  // namespace xauto::story
