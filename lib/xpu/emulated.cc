// SPDX-License-Identifier: Apache-2.0
// Emulated XPUs: suspend and resume are requests to xauto-emud, as TSG disable and enable are
// requests to the driver.
#include <map>
#include <optional>
#include <string>

#include "base/pi_mutex.h"
#include "emu/client.h"
#include "xpu/backend.h"

namespace xauto::xpu {
namespace {

class Emulated final : public Backend {
 public:
  explicit Emulated(std::optional<emu::Control> control) : control_(std::move(control)) {}

  Status attach(const SchedHandle& handle) override { return check_emulated(handle); }
  Status preempt(const SchedHandle& handle) override {
    XAUTO_TRY(check_emulated(handle));
    const Guard lock(mutex_);
    return control_->suspend(static_cast<std::uint32_t>(handle.value()));
  }
  Status restore(const SchedHandle& handle) override {
    XAUTO_TRY(check_emulated(handle));
    const Guard lock(mutex_);
    return control_->resume(static_cast<std::uint32_t>(handle.value()));
  }
  Status level(const SchedHandle& handle, int level) override {
    XAUTO_TRY(check_emulated(handle));
    const Guard lock(mutex_);
    const auto context = static_cast<std::uint32_t>(handle.value());
    int& last = levels_[context];
    if (last == level) return {};
    XAUTO_TRY(control_->level(context, level));
    last = level;
    return {};
  }

 private:
  PiMutex mutex_;  ///< the execution thread asks for levels, the management thread suspends
  std::optional<emu::Control> control_ XAUTO_GUARDED_BY(mutex_);  ///< none: nobody schedules
  std::map<std::uint32_t, int> levels_ XAUTO_GUARDED_BY(mutex_);  ///< on which they are
};

}  // namespace

Status check_emulated(const SchedHandle& handle) {
  using Kind = SchedHandle::Kind;
  if (handle.kind() == Kind::kEmulated) return {};
  return fail(ErrorCode::kInvalid,
              "returned SchedHandle::" + std::string(handle.kind_name()) +
                  "(), it computes itself, and its XPU is emulated in this run",
              {},
              handle.kind() == Kind::kThread
                  ? "name what shall be emulated, and the CPUs are real: --emulate gpu,dla; or "
                    "profile again: app.json then says where it computes itself"
                  : "on an emulated XPU `init` returns emu::Context::handle()");
}

Surroundings Surroundings::of_this_thread() {
  Surroundings surroundings;
  surroundings.site_ = emu::this_threads_site();
  return surroundings;
}

void Surroundings::enter() const {
  emu::set_this_threads_site(std::static_pointer_cast<const emu::Site>(site_));
}

Result<std::unique_ptr<Backend>> make_emulated(bool scheduled) {
  std::optional<emu::Control> control;
  if (scheduled) {
    XAUTO_ASSIGN(control, emu::Control::connect());
  }
  return std::unique_ptr<Backend>(std::make_unique<Emulated>(std::move(control)));
}

}  // namespace xauto::xpu
