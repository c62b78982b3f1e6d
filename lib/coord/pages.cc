// SPDX-License-Identifier: Apache-2.0
#include "coord/pages.h"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <utility>

#include <sys/eventfd.h>
#include <sys/mman.h>

#include "base/memory_file.h"

namespace xauto::coord {
namespace {

constexpr std::int64_t kRingsOfJob = 4;   ///< START and FINISH, and as many in doubt
constexpr std::int64_t kRingsAtOnce = 8;  ///< of each XNode, beyond the mean

}  // namespace

Result<RunPage> RunPage::make(const Regulate& run, Discipline discipline) {
  RunPage page;
  const std::size_t bytes = Shm::bytes(0);
  XAUTO_ASSIGN(page.memory_, sealed_memory("xauto-page", bytes));
  page.doorbell_ = UniqueFd(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK));
  void* memory = mmap(nullptr, bytes, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_POPULATE,
                      page.memory_.get(), 0);
  if (memory == MAP_FAILED || !page.doorbell_)
    return fail(ErrorCode::kIo, std::string("cannot make a page: ") + strerror(errno));
  page.shm_ = Shm::at(memory);
  new (page.shm_.header) Header;
  for (int i = 0; i < kMaxSlots; ++i) new (page.shm_.slots + i) SlotMemory;
  Header& header = *page.shm_.header;
  header.version = kShmVersion;
  header.discipline = static_cast<std::uint8_t>(discipline);
  header.regulated = 1;
  header.owner.store(kFat);
  header.magic = kShmMagic;
  page.hostile_ = run.hostile != 0;
  double rate = 0;  // jobs in a ns
  for (std::uint32_t i = 0; i < run.num_tasks; ++i) {
    page.xnodes_.push_back(run.tasks[i].xnode);
    rate += 1 / static_cast<double>(run.tasks[i].period_ns);
  }
  page.ring_ns_ = std::max<std::int64_t>(
      1, static_cast<std::int64_t>(1 / (static_cast<double>(kRingsOfJob) * rate)));
  return page;
}

RunPage::RunPage(RunPage&& other) noexcept
    : workers(other.workers),
      deaf_until_ns(other.deaf_until_ns),
      memory_(std::move(other.memory_)),
      doorbell_(std::move(other.doorbell_)),
      shm_(std::exchange(other.shm_, {})),
      hostile_(other.hostile_),
      xnodes_(std::move(other.xnodes_)),
      ring_ns_(other.ring_ns_),
      free_ns_(other.free_ns_) {}

RunPage::~RunPage() {
  if (shm_.header != nullptr) munmap(shm_.header, Shm::bytes(0));
}

std::int64_t RunPage::rung(std::int64_t now_ns) {
  free_ns_ = std::max(free_ns_, now_ns) + ring_ns_;
  return free_ns_ - kRingsAtOnce * static_cast<std::int64_t>(xnodes_.size()) * ring_ns_;
}

}  // namespace xauto::coord
