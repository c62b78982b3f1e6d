// SPDX-License-Identifier: Apache-2.0
// What is behind a SchedHandle::custom() or on_levels().
#pragma once

#include <functional>

#include <xauto/xpu.h>

namespace xauto {

struct SchedHandle::Callbacks {
  std::function<Status()> suspend, resume;  ///< of custom()
  std::function<Status(int)> take;          ///< of on_levels()
};

}  // namespace xauto
