// SPDX-License-Identifier: Apache-2.0
// Words about buffers from a publisher that says anything and hands over any descriptor: what is taken can be read to its last
// byte and not be written, their number is bounded, and every descriptor is closed in the end.
#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <vector>

#include <fcntl.h>
#include <sys/mman.h>
#include <unistd.h>

#include "base/socket.h"
#include "transport/buffer_passing.h"

#include "tests/open_descriptors.h"

namespace {

using namespace xauto;

UniqueFd memory(unsigned seals, off_t bytes) {
  UniqueFd fd(memfd_create("fuzz", MFD_CLOEXEC | MFD_ALLOW_SEALING));
  if (!fd || ftruncate(fd.get(), bytes) != 0 || fcntl(fd.get(), F_ADD_SEALS, seals) != 0)
    std::abort();
  return fd;
}

/// What a packet may bring.
const std::vector<UniqueFd>& goods() {
  static const std::vector<UniqueFd> all = [] {
    std::vector<UniqueFd> fds;
    fds.push_back(memory(F_SEAL_SHRINK, 4096));
    fds.push_back(memory(F_SEAL_SHRINK | F_SEAL_GROW | F_SEAL_SEAL, 100));
    fds.push_back(memory(F_SEAL_GROW, 4096));
    fds.push_back(memory(F_SEAL_SHRINK, 0));
    fds.emplace_back(open("/dev/zero", O_RDWR | O_CLOEXEC));
    fds.emplace_back(open("/proc/self/exe", O_RDONLY | O_CLOEXEC));
    fds.emplace_back(open("/", O_RDONLY | O_CLOEXEC));
    return fds;
  }();
  return all;
}

void play(const std::uint8_t* data, std::size_t size) {
  auto ends = transport::make_buffer_ends();
  if (!ends) std::abort();
  transport::BufferReceiver reader("fuzz", std::move(ends->reader));
  while (size >= 2) {
    // How many descriptors and from where, how long a packet; then its bytes.
    std::vector<int> fds;
    for (std::size_t i = 0; i < data[0] % 4u; ++i)
      fds.push_back(goods()[(data[0] / 4 + i) % goods().size()].get());
    const std::size_t length = std::min<std::size_t>(data[1] % 40, size - 2);
    if (length > 0) (void)send_packet(ends->publisher.get(), data + 2, length, fds);
    data += 2 + length;
    size -= 2 + length;
    if (data[-1] % 3 == 0) reader.drain();
  }
  reader.drain();
  if (reader.known() > 2 * transport::kMaxKnownBuffers) std::abort();
  for (std::uint64_t number = 0; number < 64; ++number)
    if (const auto found = reader.find(number)) {
      const auto at = found->map();
      volatile std::byte last = at ? (*at)[found->size() - 1] : std::byte{};
      (void)last;
      if (number == 0 || !at || found->is_writable()) std::abort();
    }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static const bool quiet = setenv("XAUTO_LOG", "off", 0) == 0;
  if (!quiet) std::abort();
  (void)goods();
  const std::size_t before = open_descriptors();
  play(data, size);
  if (open_descriptors() != before) std::abort();
  return 0;
}
