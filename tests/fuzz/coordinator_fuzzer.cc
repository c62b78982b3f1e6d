// SPDX-License-Identifier: Apache-2.0
// A broken or hostile worker: packets to the coordinator's socket, and anything at all in the
// shared memory, with a look of the coordinator after each step. It must neither die nor hang.
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <string>
#include <vector>

#include <fcntl.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include "base/socket.h"
#include "coord/protocol.h"
#include "coord/server.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace xauto;
  using namespace xauto::coord;
  const std::string address = "xauto-fuzz/coord-" + std::to_string(getpid());
  if (size < 2) return 0;
  const auto discipline = static_cast<Discipline>(data[0] % 3);
  auto server = Server::create(
      {address, "x", discipline, std::vector<std::string>(8, "n"), {{0, 1}, {2, 3}}});
  if (!server) std::abort();
  // The server's side of a connection is handed to it as run() would; we keep the other end.
  int ends[2];
  if (socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0, ends) != 0) std::abort();
  // Whether it has a page of its own, and what it may have.
  const bool regulated = data[1] >= 128;
  Regulate run{.lease = 7, .num_tasks = 4};
  for (std::uint32_t i = 0; i < 4; ++i)
    run.tasks[i] = {
        .xnode = i, .period_ns = 1000, .window_ns = 500, .longest_ns = 500, .budget_ns = 1 + i};
  if (regulated && !(*server)->regulate(run)) std::abort();
  (*server)->adopt_connection(UniqueFd(ends[0]), {.lease = 7, .regulated = regulated ? 1u : 0u});
  const UniqueFd ours(ends[1]);
  Hello hello;
  hello.num_xnodes = 4;
  hello.num_order = data[0] % 2 == 0 ? 2 : 0;
  for (std::uint32_t i = 0; i < 4; ++i) hello.xnodes[i] = i;
  if (data[1] % 4 == 0) std::memcpy(&hello, data, std::min(size, sizeof hello));
  if (!(*server)->handle_packet(ends[0], &hello, sizeof hello)) return 0;
  Refused answer;
  std::vector<UniqueFd> fds;
  if (!receive_packet(ours.get(), &answer, sizeof answer, &fds) || fds.size() != 2) return 0;
  struct stat status {};
  fstat(fds[0].get(), &status);
  const auto bytes = static_cast<std::size_t>(status.st_size);
  auto* memory = static_cast<std::uint8_t*>(
      mmap(nullptr, bytes, PROT_READ | PROT_WRITE, MAP_SHARED, fds[0].get(), 0));
  if (memory == MAP_FAILED) std::abort();
  for (std::size_t i = 2; i + 4 <= size; i += 4) {
    // The words that matter are in the header and in our slot.
    const std::size_t where = (static_cast<std::size_t>(data[i]) << 1 | (data[i + 1] & 1)) %
                              (sizeof(Header) + sizeof(SlotMemory));
    memory[where % bytes] = data[i + 2];
    if (data[i + 3] % 4 == 0)
      memory[sizeof(Header)] = static_cast<std::uint8_t>(data[i + 3] & 0xfd);
    (*server)->look();
    if (data[i + 3] % 32 == 1) (void)(*server)->status();
  }
  munmap(memory, bytes);
  return 0;
}
