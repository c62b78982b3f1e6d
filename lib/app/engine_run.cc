// SPDX-License-Identifier: Apache-2.0
#include "app/engine_run.h"

#include <vector>

#include "base/pi_mutex.h"
#include "engine/engine.h"

namespace xauto::app {

Ran run_engine(const detail::AppSpecErased& app, const runtime::Session& session,
               std::atomic<bool>& stop, std::shared_ptr<const void> held) {
  auto engine = runtime::Engine::create(app, session, stop);
  if (!engine) return {tl::unexpected<Error>(std::move(engine).error())};
  Ran ran{(*engine)->run(), (*engine)->member(), (*engine)->stuck()};
  if (ran.stuck) {
    struct Kept {
      std::unique_ptr<runtime::Engine> engine;
      std::shared_ptr<const void> held;
    };
    static PiMutex mutex;
    static auto* for_ever = new std::vector<Kept>;  // reachable, so that it is no leak
    const Guard lock(mutex);
    for_ever->push_back({*std::move(engine), std::move(held)});
  }
  return ran;
}

}  // namespace xauto::app
