// SPDX-License-Identifier: Apache-2.0
// The app and the platform of tests/golden, for which the fuzzers read what is from outside.
#pragma once

#include "model/app.h"
#include "model/periodic.h"
#include "model/platform.h"

namespace xauto::fuzz {

inline Platform golden_platform() {
  return {"bench",
          {{"cpu0", "cpu", true, 0, 0, -1},
           {"cpu1", "cpu", true, 0, 0, -1},
           {"gpu0", "gpu", true, 275, 1000, -1},
           {"dla0", "dla", false, 132, 1000, 40}}};
}

/// Of app.json there: it releases one at a time.
inline AppSpec golden_app() {
  AppSpec app{"driving",
              true,
              {{"fcd.pre", "FCD", {{"cpu", 3000}, {"gpu", 900}}, {0}},
               {"fcd.infer", "FCD", {{"dla", 11000}, {"gpu", 7000}}},
               {"fcd.post", "FCD", {{"cpu", 1500}}},
               {"spur/größe", "LA", {{"cpu", 2500}}, {1}}},
              {{0, 1}, {1, 2}},
              100000,
              {{"camera", kNoRate}, {"lidar/größe", kNoRate}}};
  complete_modules(app);
  complete_chains(app);
  give_deadlines(app);
  return app;
}

}  // namespace xauto::fuzz
