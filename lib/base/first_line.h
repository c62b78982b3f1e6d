// SPDX-License-Identifier: Apache-2.0
// How /sys and /proc answer: one line.
#pragma once

#include <fstream>
#include <string>

namespace xauto {

/// Empty if the file cannot be read.
inline std::string first_line(const std::string& path) {
  std::ifstream file(path);
  std::string line;
  std::getline(file, line);
  return line;
}

}  // namespace xauto
