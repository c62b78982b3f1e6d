// SPDX-License-Identifier: Apache-2.0
#include "coord/observer.h"

#include <cerrno>
#include <cstring>

#include <sys/mman.h>
#include <sys/stat.h>

#include "base/socket.h"
#include "base/unique_fd.h"
#include "coord/protocol.h"
#include "coord/worker_side.h"

namespace xauto::coord {

Result<std::unique_ptr<Observer>> Observer::connect(const std::string& address) {
  const std::string where = "coordinator '" + address + "'";
  XAUTO_ASSIGN(Door door, parse_door(address));
  XAUTO_ASSIGN(const UniqueFd socket, open_door(door));
  const auto ask = static_cast<std::uint32_t>(MessageKind::kObserve);
  XAUTO_TRY(send_packet(socket.get(), &ask, sizeof ask));
  Welcome answer;
  std::vector<UniqueFd> fds;
  XAUTO_ASSIGN(const std::size_t size, receive_packet(socket.get(), &answer, sizeof answer, &fds));
  struct stat status {};
  if (size != sizeof answer || fds.size() != 1 || fstat(fds[0].get(), &status) != 0 ||
      static_cast<std::size_t>(status.st_size) < Shm::bytes(0))
    return fail(ErrorCode::kUnavailable, "answered with an unknown message", where);
  auto observer = std::unique_ptr<Observer>(new Observer);
  observer->door_ = std::move(door);
  observer->bytes_ = static_cast<std::size_t>(status.st_size);
  void* memory =
      mmap(nullptr, observer->bytes_, PROT_READ, MAP_SHARED | MAP_POPULATE, fds[0].get(), 0);
  if (memory == MAP_FAILED)
    return fail(ErrorCode::kIo, std::string("cannot map shared memory: ") + strerror(errno), where);
  observer->shm_ = Shm::at(memory);
  const Header& header = *observer->shm_.header;
  if (header.magic != kShmMagic || header.version != kShmVersion)
    return fail(ErrorCode::kUnavailable, "shared memory has another version than this library",
                where, "use xauto-coordinator and libxauto of one build");
  return observer;
}

Observer::~Observer() {
  if (shm_.header != nullptr) munmap(shm_.header, bytes_);
}

void Observer::running(std::vector<Running>& out) const {
  const std::uint64_t owner = shm_.header->owner.load();
  for (int i = 0; i < kMaxSlots; ++i) {
    const SlotMemory& slot = shm_.slots[i];
    const std::uint32_t request = slot.worker.request.load();
    const std::uint32_t generation = request_generation(request);
    const Want want = request_want(request);
    if (slot.coordinator.used.load() == 0 || want == Want::kIdle) continue;
    if (want != Want::kRuns) {
      const bool owns = owner_slot(owner) == i && owner_generation(owner) == generation;
      const bool suspended = (slot.coordinator.command.load() & 1u) != 0;
      if ((!owns && slot.coordinator.grant.load() != generation) || suspended) continue;
    }
    const auto xnode = own_xnode(door_, slot.worker.xnode.load());
    if (!xnode) continue;
    const Running job{i, generation, *xnode,
                      with_lent<RealAtomics>(slot.worker, generation, slot.worker.key.load())};
    if (slot.worker.request.load() == request) out.push_back(job);
  }
}

}  // namespace xauto::coord
