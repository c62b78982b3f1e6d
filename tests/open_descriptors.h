// SPDX-License-Identifier: Apache-2.0
// How many descriptors this process has open, for tests of what closes them.
#pragma once

#include <cstddef>
#include <filesystem>
#include <iterator>

namespace xauto {

/// One more than there are: the folder's own is among them. To be compared.
inline std::size_t open_descriptors() {
  const std::filesystem::directory_iterator all("/proc/self/fd");
  return static_cast<std::size_t>(std::distance(begin(all), end(all)));
}

}  // namespace xauto
