// SPDX-License-Identifier: Apache-2.0
// XPUs that an app brings itself: it knows how their work is suspended (SchedHandle::custom).
#include <exception>
#include <string>

#include "xpu/backend.h"
#include "xpu/callbacks.h"

namespace xauto::xpu {
namespace {

/// What a user's callback throws must not end the management thread.
Status call(const std::function<Status()>& callback, const char* which) {
  try {
    return callback();
  } catch (const std::exception& e) {
    return fail(ErrorCode::kUnavailable, std::string(which) + " threw: " + e.what());
  } catch (...) {
    return fail(ErrorCode::kUnavailable,
                std::string(which) + " threw something that is no std::exception");
  }
}

class Custom final : public Backend {
 public:
  Status attach(const SchedHandle& handle) override {
    if (handle.callbacks() != nullptr) return {};
    return fail(ErrorCode::kInvalid,
                "the XPU is preemptive in the platform file, and its scheduling handle says not "
                "how its work is suspended",
                {}, "return SchedHandle::custom(suspend, resume), or write \"preemptive\": false");
  }
  Status preempt(const SchedHandle& handle) override {
    return call(handle.callbacks()->suspend, "suspend");
  }
  Status restore(const SchedHandle& handle) override {
    return call(handle.callbacks()->resume, "resume");
  }
};

}  // namespace

Result<std::unique_ptr<Backend>> make_custom(const XpuId&) {
  return std::unique_ptr<Backend>(std::make_unique<Custom>());
}

}  // namespace xauto::xpu
