// SPDX-License-Identifier: Apache-2.0
// The malformed inputs of tests/golden/errors and the message each must give, as cases.py there has
// written them into the build's folder: tests/golden/errors/README.md.
#pragma once

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include <xauto/result.h>

namespace xauto::test {

inline std::filesystem::path golden() {
  return std::filesystem::path(XAUTO_SOURCE_DIR) / "tests/golden";
}

inline std::string slurp(const std::filesystem::path& path) {
  std::ifstream in(path, std::ios::binary);
  EXPECT_TRUE(in.good()) << path;
  return {std::istreambuf_iterator<char>(in), {}};
}

inline std::filesystem::path made_cases() {
  return std::filesystem::path(XAUTO_BINARY_DIR) / "tests/errors";
}

/// The malformed files of a format, by name.
inline std::vector<std::filesystem::path> malformed(const std::string& format) {
  std::vector<std::filesystem::path> cases;
  for (const auto& entry : std::filesystem::directory_iterator(made_cases() / format))
    cases.push_back(entry.path());
  std::sort(cases.begin(), cases.end());
  return cases;
}

/// Compares with the case's message; XAUTO_UPDATE_GOLDEN=1 writes it instead, for cases.py --update.
inline void expect_message(const std::filesystem::path& input, const Error& error) {
  const auto expected = made_cases() / "messages" / input.parent_path().filename() / input.stem();
  const std::string text = error.to_string() + "\n";
  if (std::getenv("XAUTO_UPDATE_GOLDEN") != nullptr) {
    std::ofstream(expected, std::ios::binary) << text;
    return;
  }
  EXPECT_EQ(slurp(expected), text) << input;
  EXPECT_TRUE(error.code == ErrorCode::kInvalid)
      << input << ": the tools exit with 2 for kInvalid only";
}

}  // namespace xauto::test
