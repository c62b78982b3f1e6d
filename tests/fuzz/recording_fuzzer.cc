// SPDX-License-Identifier: Apache-2.0
// A recorded input from outside: any bytes as a .db3 are refused, or read to an end in bounded
// time.
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <string>

#include <unistd.h>

#include "record/recording.h"

namespace {

std::string scratch() {
  static const std::string path = [] {
    const bool shm = access("/dev/shm", W_OK) == 0;
    return std::string(shm ? "/dev/shm" : "/tmp") + "/xauto_fuzz_recording." +
           std::to_string(getpid()) + ".db3";
  }();
  static const int at_exit = std::atexit([] { unlink(scratch().c_str()); });
  (void)at_exit;
  return path;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace xauto;
  std::ofstream(scratch(), std::ios::binary)
      .write(reinterpret_cast<const char*>(data), static_cast<std::streamsize>(size));
  auto recording = record::Recording::open(scratch());
  Status status;
  if (!recording) status = tl::unexpected<Error>(recording.error());
  std::uint64_t messages = 0;
  while (status) {
    const auto message = recording->next();
    if (!message)
      status = tl::unexpected<Error>(message.error());
    else if (!*message)
      break;
    else if (++messages > size || (*message)->topic >= recording->topics().size())
      std::abort();
  }
  if (!status && (status.error().what.empty() || status.error().to_string().size() > 4096))
    std::abort();
  return 0;
}
