// SPDX-License-Identifier: Apache-2.0
// What is behind a SchedHandle::custom().
#pragma once

#include <functional>

#include <xauto/xpu.h>

namespace xauto {

struct SchedHandle::Callbacks {
  std::function<Status()> suspend, resume;
};

}  // namespace xauto
