// SPDX-License-Identifier: Apache-2.0
// What a deployed policy says of one XNode, for people and tools: a row of its BPF map (xpu/policy_view.h).
#pragma once

#include <cstdint>
#include <string>

namespace xauto {

struct PolicyRow {
  std::string xnode, xpu;  ///< names; of an XPU none where the run places nothing
  std::string by;          ///< "key_us", "priority", "nobody", "off"
  std::uint32_t keys = 0;  ///< how many it has
  std::int64_t value = 0;  ///< the first key in us, or the priority
  std::uint32_t xpu_index = 0, table = 0;
};

}  // namespace xauto
