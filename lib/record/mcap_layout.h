// SPDX-License-Identifier: Apache-2.0
// Where what is in an MCAP file. Found by walking from record to record, without reading what is in
// the chunks. So a file that its recorder did not close is read like any other, and an index that
// lies leads nowhere. Only the topics and the number of messages come from the summary. Where it has
// none, all chunks are looked through once.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "record/mcap_file.h"

namespace xauto::record::mcap {

struct Layout {
  Channels channels;
  std::vector<Block> blocks;  ///< that hold messages, by their place
  std::uint64_t num_messages = 0;
  /// Of a file without an end: what ends the reading, for people. Else empty.
  std::string damage;
  std::uint64_t data_end = 0;  ///< where the data section's checksum ends
  std::uint32_t data_crc = 0;  ///< 0: none
};

[[nodiscard]] Result<Layout> find_layout(File& file);

}  // namespace xauto::record::mcap
