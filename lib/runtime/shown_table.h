// SPDX-License-Identifier: Apache-2.0
// Which table of a run with tables is in force, for who looks from outside.
#pragma once

#include <cstddef>
#include <functional>

#include "session/session.h"

namespace xauto::runtime {

/// To be told of each table that releases get: shows it in the policy's BPF map, if the run has one. It does not wait.
/// `session` outlives it.
[[nodiscard]] std::function<void(std::size_t table)> shower_of_tables(const Session& session);

}  // namespace xauto::runtime
