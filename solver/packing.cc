// SPDX-License-Identifier: Apache-2.0
// See packing.h.
#include "solver/packing.h"

namespace xauto::solver {

Time packed(Time work, Time length, Time grain) {
  if (grain == 0) return work;
  if (grain > 0) return 2 * work > length ? length / grain - (length - work) / grain : work / grain;
  if (work < -grain) return 0;
  return work > length + grain ? length : work;
}

Time packed_room(Time length, Time grain) {
  return grain > 0 ? length / grain : length;
}

double Packing::in_grains(Time length, Time grain) const {
  const auto whole = static_cast<double>(length);
  const auto room = static_cast<double>(packed_room(length, grain));
  const double inverse = 1 / static_cast<double>(grain);
  double sum = 0;
  for (std::size_t k = 0; k < work_.size(); ++k) {
    const bool more_than_half = 2 * work_[k] > whole;
    const double counted = (more_than_half ? whole - work_[k] : work_[k]) * inverse + 1e-9;
    const auto grains = static_cast<double>(static_cast<std::int64_t>(counted));
    sum += fraction_[k] * (more_than_half ? room - grains : grains);
  }
  return sum / room;
}

double Packing::in_between(Time length, Time cut) const {
  const auto whole = static_cast<double>(length), least = static_cast<double>(cut);
  double sum = 0;
  for (std::size_t k = 0; k < work_.size(); ++k) {
    const double work = work_[k];
    sum += fraction_[k] * (work < least ? 0 : work > whole - least ? whole : work);
  }
  return sum / whole;
}

double Packing::excess(Time length, double instances, Time& grain) const {
  constexpr std::size_t kMost = 24;  // XNodes whose work is tried as a grain; of more, a sample
  double most = 0;
  grain = 0;
  const auto take = [&](double full, Time by) {
    if (full - instances <= most) return;
    most = full - instances;
    grain = by;
  };
  const auto grains = [&](Time by) {
    if (by > 0 && by <= length) take(in_grains(length, by), by);
  };
  const auto cut = [&](Time at) {
    if (at > 0 && at <= length) take(in_between(length, at), -at);
  };
  const std::size_t step = work_.size() / kMost + 1;
  for (std::size_t k = 0; k < work_.size(); k += step) {
    const auto work = static_cast<Time>(work_[k]);
    // Grains so small that nearly all is counted are the energy once more.
    if (5 * work > length) {
      grains(work);
      grains(work / 2);
    }
    grains(length - work + 1);
    grains((length - work) / 2 + 1);
    if (2 * work <= length) {
      cut(work);
      cut(work + 1);
    } else {
      cut(length - work + 1);
    }
  }
  grains(length / 2 + 1);
  return most;
}

}  // namespace xauto::solver
