// SPDX-License-Identifier: Apache-2.0
// The app and the platform of tests/golden, for which the fuzzers read what is from outside.
#pragma once

#include "model/app.h"
#include "model/platform.h"

namespace xauto::fuzz {

inline Platform golden_platform() {
  return {"bench",
          {{"cpu0", "cpu", true, 0, 0, -1},
           {"cpu1", "cpu", true, 0, 0, -1},
           {"gpu0", "gpu", true, 275, 1000, -1},
           {"dla0", "dla", false, 132, 1000, 40}}};
}

inline AppSpec golden_app() {
  return {1,
          "driving",
          {{"fcd.pre", "FCD", {{"cpu", 3000}, {"gpu", 900}}},
           {"fcd.infer", "FCD", {{"dla", 11000}, {"gpu", 7000}}},
           {"fcd.post", "FCD", {{"cpu", 1500}}},
           {"spur/größe", "LA", {{"cpu", 2500}}}},
          {{0, 1}, {1, 2}},
          100000};
}

}  // namespace xauto::fuzz
