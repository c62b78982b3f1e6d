// SPDX-License-Identifier: Apache-2.0
// The door of a backend whose queues this process suspends itself: `Queues` is of lib/kernel, as
// OwnQueues. Nobody resumes what a process has suspended that hangs.
#pragma once

#include <utility>
#include <vector>

#include "kernel/patience.h"
#include "xpu/driver_queues.h"

namespace xauto::xpu {

template <class Queues>
class ProcessDoor final : public QueueDoor {
 public:
  Result<Handle> take(const kernel::QueueFile& file) override { return queues_.take(file); }
  void give_back(Handle handle) override { queues_.give_back(handle); }
  Status suspend(const std::vector<Handle>& handles) override {
    if constexpr (requires { queues_.suspend(handles); }) {
      return queues_.suspend(handles);
    } else {
      for (const Handle handle : handles) XAUTO_TRY(queues_.suspend(handle));
      return {};
    }
  }
  /// All of them: nobody else would resume the rest.
  Status resume(const std::vector<Handle>& handles) override {
    if constexpr (requires { queues_.resume(handles); }) {
      return queues_.resume(handles);
    } else {
      Status done;
      for (const Handle handle : handles)
        if (Status one = queues_.resume(handle); !one) done = std::move(one);
      return done;
    }
  }
  bool gated(Handle handle) override { return queues_.gated(handle); }
  Status still_wanted() override {
    queues_.again();
    return {};
  }
  int again_ms() const override { return kernel::kAgainMs; }
  bool owes() const override { return queues_.owes(); }

 private:
  Queues queues_;
};

}  // namespace xauto::xpu
