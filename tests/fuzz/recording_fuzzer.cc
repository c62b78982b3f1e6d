// SPDX-License-Identifier: Apache-2.0
// A recorded input from outside: any bytes as a .db3, or as an .mcap where they begin as one, are refused,
// or read to an end in bounded time.
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <string>

#include <unistd.h>

#include "record/recording.h"
#include "record/salvage.h"

namespace {

std::string scratch(const char* suffix) {
  static const std::string path = [] {
    const bool shm = access("/dev/shm", W_OK) == 0;
    return std::string(shm ? "/dev/shm" : "/tmp") + "/xauto_fuzz_recording." +
           std::to_string(getpid());
  }();
  static const int at_exit = std::atexit([] {
    unlink(scratch(".db3").c_str());
    unlink(scratch(".mcap").c_str());
  });
  (void)at_exit;
  return path + suffix;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace xauto;
  // A byte may be wrong: also the first one of an MCAP file.
  const bool mcap = size > 4 && data[1] == 'M' && data[2] == 'C';
  const std::string path = scratch(mcap ? ".mcap" : ".db3");
  std::ofstream(path, std::ios::binary)
      .write(reinterpret_cast<const char*>(data), static_cast<std::streamsize>(size));
  auto recording = record::Recording::open(path);
  Status status;
  if (!recording)
    status = tl::unexpected<Error>(recording.error());
  else
    status = recording->verify();
  std::uint64_t messages = 0;
  while (status) {
    const auto message = recording->next();
    if (!message)
      status = tl::unexpected<Error>(message.error());
    else if (!*message)
      break;
    else if ((++messages > size && !mcap) || (*message)->topic >= recording->topics().size())
      std::abort();
  }
  // Whatever is wrong with it, reading on behind it comes to an end, and does not find more than there is.
  std::uint64_t taken = 0;
  const auto salvaged = record::salvage(
      path,
      [&](const record::Topic& topic, std::int64_t stamp_ns, std::span<const std::byte>) -> Status {
        if (topic.name.empty() || stamp_ns < 0) std::abort();
        ++taken;
        return {};
      });
  if (!salvaged || salvaged->messages != taken || (mcap && taken < (status ? messages : 0)))
    std::abort();
  if (!status && (status.error().what.empty() || status.error().to_string().size() > 4096))
    std::abort();
  return 0;
}
