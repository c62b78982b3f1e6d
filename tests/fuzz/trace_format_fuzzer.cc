// SPDX-License-Identifier: Apache-2.0
// The kernel's description of a tracepoint's record: whatever it says, what is read lies within a record.
#include <cstdint>
#include <cstdlib>
#include <string>

#include "kernel/trace_format.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string text(reinterpret_cast<const char*>(data), size);
  for (const char* name : {"prev_pid", "prev_state", "next_comm", ""}) {
    const auto field = xauto::kernel::trace_field(text, name);
    if (field && (field->at < 8 || field->size == 0 || field->at + field->size > 8192)) abort();
  }
  return 0;
}
