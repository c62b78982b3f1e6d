// SPDX-License-Identifier: Apache-2.0
#include "xpu/callbacks.h"

namespace xauto {

SchedHandle SchedHandle::custom(std::function<Status()> suspend, std::function<Status()> resume) {
  SchedHandle handle{Kind::kCustom, 0};
  handle.callbacks_ =
      std::make_shared<const Callbacks>(Callbacks{std::move(suspend), std::move(resume)});
  return handle;
}

const char* SchedHandle::kind_name() const {
  switch (kind_) {
    case Kind::kGate:
      return "gate";
    case Kind::kThread:
      return "thread";
    case Kind::kCudaContext:
      return "cuda_context";
    case Kind::kCudlaDevice:
      return "cudla_device";
    case Kind::kEmulated:
      return "emulated";
    case Kind::kCustom:
      return "custom";
  }
  return "?";
}

}  // namespace xauto
