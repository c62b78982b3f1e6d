// SPDX-License-Identifier: Apache-2.0
// What the app itself does: XPUs that it brings, of which it knows how their work is suspended (SchedHandle::custom),
// and queues of its own on the priority levels of an XPU (SchedHandle::on_levels).
#include <exception>
#include <string>

#include "xpu/backend.h"
#include "xpu/callbacks.h"

namespace xauto::xpu {
namespace {

/// What a user's callback throws must not end the thread that calls it.
template <class... Arguments>
Status call(const std::function<Status(Arguments...)>& callback, const char* which,
            Arguments... arguments) {
  try {
    return callback(arguments...);
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
    if (handle.kind() == SchedHandle::Kind::kCustom) return {};
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

class OnLevels final : public Backend {
 public:
  Status attach(const SchedHandle& handle) override {
    if (handle.kind() == SchedHandle::Kind::kLevels) return {};
    return fail(
        ErrorCode::kInvalid,
        std::string("the XPU has \"levels\" in the platform file, and its scheduling handle is ") +
            handle.kind_name() + "(), which puts no work on them",
        {},
        "return SchedHandle::on_levels(take), as xauto::cuda::Context::handle() does, or leave out "
        "\"levels\"");
  }
  Status preempt(const SchedHandle&) override {
    return fail(ErrorCode::kUnavailable, "levels suspend nothing");
  }
  Status restore(const SchedHandle&) override { return {}; }
  Status level(const SchedHandle& handle, int level) override {
    return call(handle.callbacks()->take, "take", level);
  }
};

}  // namespace

Result<std::unique_ptr<Backend>> make_on_levels(const XpuId&) {
  return std::unique_ptr<Backend>(std::make_unique<OnLevels>());
}

Result<std::unique_ptr<Backend>> make_custom(const XpuId&) {
  return std::unique_ptr<Backend>(std::make_unique<Custom>());
}

}  // namespace xauto::xpu
