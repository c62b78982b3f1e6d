// SPDX-License-Identifier: Apache-2.0
// Ids are ints (as in files and messages); containers are indexed by size_t.
#pragma once

#include <cstddef>

namespace xauto {

/// The id as an index of a container. It must not be negative.
constexpr std::size_t at(int id) {
  return static_cast<std::size_t>(id);
}

}  // namespace xauto
