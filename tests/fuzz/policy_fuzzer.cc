// SPDX-License-Identifier: Apache-2.0
// policy.json, and tables.json of keys, from outside, for apps and a platform of our own: those of tests/golden, one
// with rates and one that releases one at a time; and the first with times beside loads.
#include "model/json.h"

#include "golden.h"
#include "json_property.h"

namespace {

constexpr const char* kApp = R"json({
  "schema": "xauto.app",
  "version": 3,
  "name": "driving",
  "clocks": [
    { "name": "main", "ppm": 5 },
    { "name": "lidar", "ppm": 100 }
  ],
  "sources": [
    { "name": "camera", "rate_hz": 30, "jitter_us": 500 },
    { "name": "rear", "rate_hz": 30, "offset_us": 1000 },
    { "name": "film", "rate_hz": "30000/1001", "clock": "lidar" },
    { "name": "lidar/größe", "period_us": 100000, "jitter_us": 200, "clock": "lidar" },
    { "name": "tick", "period_us": 20000 }
  ],
  "modules": [
    { "name": "FCD", "max_in_flight": 2, "optional": false },
    { "name": "LA", "max_in_flight": 1, "optional": true },
    { "name": "MPC", "max_in_flight": 1, "optional": false }
  ],
  "xnodes": [
    {
      "name": "fcd.pre",
      "module": "FCD",
      "source": ["camera", "rear"],
      "wcet_us": { "cpu": 3000, "gpu": 900 }
    },
    {
      "name": "fcd.infer",
      "module": "FCD",
      "wcet_us": { "dla": 11000, "gpu": 7000 },
      "variants": [
        { "name": "half", "quality_pct": 80, "wcet_us": { "gpu": 4000 } }
      ]
    },
    { "name": "fcd.post", "module": "FCD", "wcet_us": { "cpu": 1500 }, "real_on": ["cpu"] },
    {
      "name": "spur/größe",
      "module": "LA",
      "source": "lidar/größe",
      "wcet_us": { "cpu": 2500 }
    },
    { "name": "mpc", "module": "MPC", "source": "tick", "wcet_us": { "cpu": 1000 } }
  ],
  "edges": [
    {
      "from": "fcd.pre",
      "to": "fcd.infer",
      "transfer_us": { "cpu": { "dla": 300 }, "gpu": { "dla": 250, "gpu": 40 } }
    },
    ["fcd.infer", "fcd.post"]
  ],
  "samples": [
    ["fcd.post", "mpc"],
    ["spur/größe", "mpc"],
    ["fcd.post", "fcd.pre"],
    ["mpc", "spur/größe"]
  ],
  "chains": [
    { "name": "brake", "from": "camera", "to": "mpc", "deadline_us": 80000 },
    { "name": "steer", "from": "lidar/größe", "to": "mpc", "weight": 3 }
  ]
}
)json";

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace xauto;
  static const Platform platform = fuzz::golden_platform();
  static const AppSpec app = parse_app(kApp, "app").value(), once = fuzz::golden_app();
  static const AppSpec loaded = [] {
    AppSpec of = app;
    of.xnodes[1].beside = {{"gpu", {{"cpu", 2}}, 8000}, {"dla", {{"gpu", 1}}, 12'000}};
    return of;
  }();
  for (const AppSpec* of : {&app, &once, &loaded}) {
    const auto read = [&](std::string_view text) {
      return parse_policy(text, fuzz::kOrigin, *of, platform);
    };
    fuzz::check_read(
        read({reinterpret_cast<const char*>(data), size}),
        [&](const Policy& policy) { return to_json(policy, *of, platform); }, read);
  }
  const auto tables = [](std::string_view text) {
    return parse_tables(text, fuzz::kOrigin, app, platform);
  };
  fuzz::check_read(
      tables({reinterpret_cast<const char*>(data), size}),
      [](const Tables& of) { return to_json(of, app, platform); }, tables);
  return 0;
}
