// SPDX-License-Identifier: Apache-2.0
// Emulated XPUs: suspend and resume are requests to xauto-emud, as TSG disable and enable are
// requests to the driver.
#include <optional>
#include <string>

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
    return control_->suspend(static_cast<std::uint32_t>(handle.value()));
  }
  Status restore(const SchedHandle& handle) override {
    XAUTO_TRY(check_emulated(handle));
    return control_->resume(static_cast<std::uint32_t>(handle.value()));
  }

 private:
  std::optional<emu::Control> control_;  ///< none: nobody schedules
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
