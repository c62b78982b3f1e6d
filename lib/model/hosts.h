// SPDX-License-Identifier: Apache-2.0
// An app over several computers: which messages cross, and how long each may be on its way.
// Threads: pure.
#pragma once

#include <vector>

#include <xauto/result.h>

#include "model/app.h"
#include "model/platform.h"
#include "model/policy.h"

namespace xauto {

/// [xnode] index into Platform::hosts; all 0 where it has none.
[[nodiscard]] std::vector<int> hosts_of(const AppSpec& app, const Platform& platform,
                                        const Policy& policy);

/// For how long a message of so many bytes has the link, without base_us. A megabit a second is a bit a microsecond.
[[nodiscard]] std::int64_t on_link_us(std::int64_t bytes, const HostLink& link);

/// What crosses: of each XNode one message to each other host on which somebody hears or samples it. Each of a link takes
///   X = base_us + sum over all that cross the link of ceil(8 message_bytes / mbit_s)
/// since in the worst case it waits for all others, each once (docs/keys.md, "Hosts").
/// kInvalid: a module pinned to a host that is not there; kInfeasible: a module on two hosts, or not on its own; hosts
/// without a link; a message that comes more than once in X.
[[nodiscard]] Result<std::vector<Crossing>> crossings_of(const AppSpec& app,
                                                         const Platform& platform,
                                                         const std::vector<int>& host_of);
[[nodiscard]] Result<std::vector<Crossing>> crossings_of(const AppSpec& app,
                                                         const Platform& platform,
                                                         const Policy& policy);

/// That each pin of a module is to a host of the platform.
[[nodiscard]] Status validate_pins(const AppSpec& app, const Platform& platform);

}  // namespace xauto
