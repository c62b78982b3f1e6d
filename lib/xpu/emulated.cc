// SPDX-License-Identifier: Apache-2.0
// Emulated XPUs: suspend and resume are requests to xauto-emud, as TSG disable and enable are
// requests to the driver.
#include "emu/client.h"
#include "xpu/backend.h"

namespace xauto::xpu {
namespace {

class Emulated final : public Backend {
 public:
  explicit Emulated(emu::Control control) : control_(std::move(control)) {}

  Status preempt(const SchedHandle& handle) override {
    XAUTO_TRY(check(handle));
    return control_.suspend(static_cast<std::uint32_t>(handle.value()));
  }
  Status restore(const SchedHandle& handle) override {
    XAUTO_TRY(check(handle));
    return control_.resume(static_cast<std::uint32_t>(handle.value()));
  }

 private:
  static Status check(const SchedHandle& handle) {
    if (handle.kind() == SchedHandle::Kind::kEmulated) return {};
    return fail(ErrorCode::kInvalid, "the scheduling handle is not an emulated context", {},
                "on an emulated platform `init` returns emu::Context::handle()");
  }
  emu::Control control_;
};

}  // namespace

Result<std::unique_ptr<Backend>> make_emulated() {
  XAUTO_ASSIGN(emu::Control control, emu::Control::connect());
  return std::unique_ptr<Backend>(std::make_unique<Emulated>(std::move(control)));
}

}  // namespace xauto::xpu
