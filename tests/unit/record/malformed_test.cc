// SPDX-License-Identifier: Apache-2.0
// What `xauto recording check` does with the malformed recordings of tests/golden/errors, of both kinds.
#include <filesystem>
#include <string>

#include <gtest/gtest.h>

#include "record/recording.h"

#include "../golden_cases.h"

namespace xauto::record {
namespace {

/// Why a file cannot be read to its end.
Status read_all(const std::string& name) {
  auto recording = Recording::open(name);
  if (!recording) return tl::unexpected<Error>(recording.error());
  XAUTO_TRY(recording->verify());
  for (;;) {
    const auto message = recording->next();
    if (!message) return tl::unexpected<Error>(message.error());
    if (!*message) return {};
  }
}

void every_case(const std::string& format, std::size_t at_least) {
  const auto cases = test::malformed(format);
  EXPECT_GE(cases.size(), at_least);
  for (const auto& input : cases) {
    std::filesystem::current_path(input.parent_path());
    const Status status = read_all(input.filename().string());
    if (status)
      ADD_FAILURE() << input << " is accepted";
    else
      test::expect_message(input, status.error());
  }
  std::filesystem::current_path("/");
}

TEST(Recordings, EveryMalformedOneOfSqliteIsRefusedWithItsMessage) {
  every_case("recording", 15);
}

TEST(Recordings, EveryMalformedOneOfMcapIsRefusedWithItsMessage) {
  every_case("mcap", 40);
}

}  // namespace
}  // namespace xauto::record
