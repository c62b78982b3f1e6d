// SPDX-License-Identifier: Apache-2.0
// The page of a run that is not trusted (shm_layout.h): memory that it shares with the coordinator alone, and a doorbell
// that is heard no more often than its jobs need. One thread.
#pragma once

#include <cstdint>
#include <vector>

#include <xauto/result.h>

#include "base/unique_fd.h"
#include "coord/protocol.h"
#include "coord/shm_layout.h"

namespace xauto::coord {

class RunPage {
 public:
  /// kIo.
  [[nodiscard]] static Result<RunPage> make(const Regulate& run, Discipline discipline);
  RunPage(RunPage&& other) noexcept;
  RunPage& operator=(RunPage&&) = delete;
  ~RunPage();

  [[nodiscard]] const Shm& shm() const { return shm_; }
  [[nodiscard]] int memory_fd() const { return memory_.get(); }
  [[nodiscard]] int doorbell_fd() const { return doorbell_.get(); }
  [[nodiscard]] bool hostile() const { return hostile_; }
  [[nodiscard]] const std::vector<std::uint32_t>& xnodes() const { return xnodes_; }

  /// It has rung: when it is heard again. At most `now_ns`: at once.
  [[nodiscard]] std::int64_t rung(std::int64_t now_ns);

  int workers = 0;                 ///< connected
  std::int64_t deaf_until_ns = 0;  ///< its doorbell is not looked at; 0: it is

 private:
  RunPage() = default;

  UniqueFd memory_, doorbell_;
  Shm shm_;
  bool hostile_ = false;
  std::vector<std::uint32_t> xnodes_;
  std::int64_t ring_ns_ = 0;  ///< so often it may ring in the mean
  std::int64_t free_ns_ = 0;  ///< all rings so far are paid for by then
};

}  // namespace xauto::coord
