// SPDX-License-Identifier: Apache-2.0
// What the processes of one app share besides topics: a doorbell each, and the counts of every
// module and XNode, which so survive the process that wrote them. With one process it is ordinary
// memory.
//
// [M] written by the process that hosts the module (or by the hub in its place once it is dead),
// [H] by the hub.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>

#include <xauto/result.h>

#include "base/unique_fd.h"
#include "transport/doorbell.h"
#include "transport/shm_topic.h"

namespace xauto::runtime {

inline constexpr std::uint32_t kMaxProcesses = 256;

struct alignas(64) BoardHeader {
  std::uint32_t magic = 0, processes = 0, modules = 0, nodes = 0;
};

/// What is counted, and checked when memory of another process is mapped.
struct BoardShape {
  std::uint32_t processes = 1, modules = 0, nodes = 0;
};

/// A release is settled once: done, failed or dropped. In an app of one rate they are settled in
/// order, so the sum of the three is the number of the next one.
struct alignas(64) ModuleLine {
  std::atomic<std::uint64_t> activations{}, failed{}, dropped{};  ///< [M]
  std::atomic<std::uint32_t> in_flight{};  ///< [M] 1: an activation is
  [[nodiscard]] std::uint64_t settled() const {
    return activations.load() + failed.load() + dropped.load();
  }
};

/// Jobs of one XNode that has limits (watch.h).
struct alignas(64) XNodeLine {
  std::atomic<std::uint64_t> jobs{}, overruns{}, hangs{};  ///< [M]
  std::atomic<std::int64_t> longest_ns{};                  ///< [M]
};

struct alignas(64) ProcessLine {
  transport::Doorbell doorbell;
  std::atomic<std::uint32_t> stand_in{};  ///< [H] whose doorbell is rung instead: its own index, or
                                          ///< 0 while it is dead
  std::atomic<std::int64_t> watched_ns{};  ///< [M] when its watchdog last looked; 0: not yet
};

class Board {
 public:
  /// In this process only.
  [[nodiscard]] static std::shared_ptr<Board> local(const BoardShape& shape);
  /// In a memfd, which is left in `fd`.
  [[nodiscard]] static Result<std::shared_ptr<Board>> create(const BoardShape& shape, UniqueFd& fd);
  [[nodiscard]] static Result<std::shared_ptr<Board>> map(int fd, const BoardShape& shape);
  ~Board();
  Board(const Board&) = delete;
  Board& operator=(const Board&) = delete;

  ModuleLine& module(int index) { return modules_[index]; }
  XNodeLine& xnode(std::size_t node) { return xnodes_[node]; }
  ProcessLine& process(int index) { return processes_[index]; }
  [[nodiscard]] int processes() const { return static_cast<int>(header_->processes); }
  [[nodiscard]] std::uint64_t settled() const;
  /// Some module has an activation in flight.
  [[nodiscard]] bool busy() const;
  /// Rings whoever reads the queues of `process` now.
  void ring(int process) {
    const std::uint32_t at = processes_[process].stand_in.load(std::memory_order_acquire);
    processes_[at < header_->processes ? at : 0].doorbell.ring();
  }

 private:
  Board(void* memory, std::size_t bytes, bool mapped, const BoardShape& shape);
  void* memory_;
  std::size_t bytes_;
  bool mapped_;
  BoardHeader* header_;
  ProcessLine* processes_;
  ModuleLine* modules_;
  XNodeLine* xnodes_;
};

}  // namespace xauto::runtime
