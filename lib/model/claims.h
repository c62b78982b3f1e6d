// SPDX-License-Identifier: Apache-2.0
// What our numbers are about, in words. Said wherever people see the number, in one way.
#pragma once

#include <cstdint>

namespace xauto {

/// What an emulated job and chain may take beside what was claimed: messages to the emulator, and
/// the sleep that it measures by. Of a job kEmulatorUs on top.
inline constexpr std::int64_t kEmulatorPct = 2, kEmulatorUs = 100;
/// An emulated job that is so much longer than its WCET shows that the emulator's machine stood still,
/// not that a clock is slower: no other scenario counts for it.
inline constexpr std::int64_t kEmulatorStallUs = 1000;

/// ChainClaim::worst_case_us bounds the reduced reaction time of ... Where `max_in_flight`, holds or
/// the order of one XNode's activations are not kept, or somebody else uses an XPU, it says nothing.
inline constexpr const char* kKeyScope =
    "every release, once each XNode that samples has started, within the app's WCETs, transfers, "
    "jitters and clock tolerances, where each XPU serves this app alone, or apps that were tested "
    "with it, by the policy's keys and holds";
/// Beside it, of an app over several hosts.
inline constexpr const char* kHostsScope = ", and each message between hosts is there by its X";
/// The same where no source has a rate.
inline constexpr const char* kOneAtATimeScope =
    "every release, let in when the one before has ended, within the app's WCETs and transfers, "
    "where each XPU serves this app alone, by the policy's keys and holds";
[[nodiscard]] constexpr const char* scope_of(bool one_at_a_time) {
  return one_at_a_time ? kOneAtATimeScope : kKeyScope;
}

}  // namespace xauto
