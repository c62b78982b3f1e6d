// SPDX-License-Identifier: Apache-2.0
#include "xpu/levels.h"

#include <xauto/xpu.h>

namespace xauto {
namespace {

thread_local int t_levels = 0;

}  // namespace

int levels(const XpuId&) {
  return t_levels;
}

xpu::TellLevels::TellLevels(int levels) {
  t_levels = levels;
}

xpu::TellLevels::~TellLevels() {
  t_levels = 0;
}

}  // namespace xauto
