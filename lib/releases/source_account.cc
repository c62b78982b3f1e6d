// SPDX-License-Identifier: Apache-2.0
#include "releases/source_account.h"

#include <algorithm>
#include <utility>

#include <fmt/format.h>

namespace xauto::runtime {

namespace {

/// Of what is off its grid: whether it comes too often, or too seldom.
std::string another_rate(const SourceAccount::Seen& seen, const Grid::Source& grid) {
  std::string text;
  if (seen.early > 0)
    text = fmt::format("; {} of them came sooner than its period and jitter allow", seen.early);
  const auto stated =
      static_cast<std::uint64_t>((seen.last_ns - seen.first_ns) / grid.period_ns()) + 1;
  // One more or less is where the run begins and ends.
  if (std::max(seen.came, stated) - std::min(seen.came, stated) > 1)
    text += fmt::format("; {} came in the time of {}", seen.came, stated);
  return text;
}

std::string words_of_late(const SourceAccount::Seen& seen, const Grid::Source& grid,
                          const std::string& name) {
  if (seen.late == 0) return {};
  const std::int64_t latest_us = (seen.latest_ns + 999) / 1000;
  return fmt::format(
      "source '{}' was released up to {} us late in {} of {} releases; app.json states a jitter of "
      "{} us: with \"jitter_us\": {} of this source `solve` plans for it",
      name, latest_us, seen.late, seen.of, grid.jitter_ns / 1000, latest_us);
}

std::string words_of_off(const SourceAccount::Seen& seen, const Grid::Source& grid,
                         const std::string& name, std::int64_t clock_ppm) {
  if (seen.off == 0) return {};
  return fmt::format(
      "source '{}' was up to {} us off its grid in {} of {} releases{}; app.json states a period "
      "of {:.3f} us, a jitter of {} us and a clock that may be {} ppm off",
      name, (seen.farthest_ns + 999) / 1000, seen.off, seen.of, another_rate(seen, grid),
      static_cast<double>(grid.period.num) / static_cast<double>(grid.period.den),
      grid.jitter_ns / 1000, clock_ppm);
}

}  // namespace

void SourceAccount::released(std::size_t source, std::int64_t after_ns) {
  Seen& seen = seen_[source];
  ++seen.of;
  if (after_ns <= context_.grid.sources[source].jitter_ns) return;
  ++seen.late;
  context_.board.count_late(after_ns);
  seen.latest_ns = std::max(seen.latest_ns, after_ns);
}

void SourceAccount::left_out(std::size_t source) {
  Seen& seen = seen_[source];
  ++seen.left_out;
  ++seen.of;
  context_.board.count_late(0);
}

void SourceAccount::came(std::size_t source, std::int64_t at_ns, std::int64_t off_ns, bool early) {
  Seen& seen = seen_[source];
  seen.off += off_ns > 0 ? 1 : 0;
  seen.early += early ? 1 : 0;
  if (seen.came++ == 0) seen.first_ns = at_ns;
  seen.last_ns = at_ns;
  if (off_ns > 0) context_.board.count_late(off_ns, early);
  seen.farthest_ns = std::max(seen.farthest_ns, off_ns);
}

void SourceAccount::made(std::size_t source, std::int64_t after_ns) {
  seen_[source].made_late_ns = std::max(seen_[source].made_late_ns, after_ns);
}

/// Two of them are so many releases apart: what is nearer is an ordinary one. By numbers, and not by
/// the time of the push, since it is the nominal releases that the certificate counts with.
bool SourceAccount::urgent(std::size_t source, std::uint64_t number) {
  Seen& seen = seen_[source];
  if (seen.last_urgent && number - *seen.last_urgent < context_.grid.sources[source].urgent_apart) {
    ++seen.too_soon;
    context_.board.count_late(0);
    return false;
  }
  seen.last_urgent = number;
  return true;
}

std::vector<std::string> SourceAccount::notes() const {
  std::vector<std::string> notes;
  for (std::size_t s = 0; s < seen_.size(); ++s)
    if (seen_[s].unheard > 0)
      notes.push_back(
          fmt::format("source '{}' marked {} releases urgent, which nothing certifies "
                      "in this run: they were ordinary ones",
                      context_.graph.sources[s].name, seen_[s].unheard));
  for (std::size_t m = 0; m < context_.graph.modules.size(); ++m)
    if (const std::uint64_t count =
            context_.board.module(static_cast<int>(m)).urgent_unheard.load();
        count > 0)
      notes.push_back(
          fmt::format("XModule '{}' marked {} results urgent, which nothing certifies in this run: "
                      "they were ordinary ones (\"marked_by\" of a source in app.json)",
                      context_.graph.modules[m].name, count));
  return notes;
}

void SourceAccount::report(const std::vector<std::unique_ptr<ClockPhase>>& phases,
                           Account& into) const {
  std::vector<std::string> off_grid, left_out, too_soon, unphased;
  std::uint64_t num_left_out = 0, num_too_soon = 0;
  for (std::size_t s = 0; s < seen_.size(); ++s) {
    const Seen& seen = seen_[s];
    const Grid::Source& grid = context_.grid.sources[s];
    const std::string& name = context_.graph.sources[s].name;
    if (const std::int64_t ns = seen.made_late_ns; ns > 0)
      into.taken.push_back(
          {fmt::format("the function of source '{}' returned up to {:.2f} ms after "
                       "its message was due",
                       name, static_cast<double>(ns) * 1e-6),
           ns / 1000});
    if (std::string words = words_of_late(seen, grid, name); !words.empty())
      off_grid.push_back(std::move(words));
    if (std::string words = words_of_off(seen, grid, name, context_.grid.clock_ppm[grid.clock]);
        !words.empty())
      off_grid.push_back(std::move(words));
    num_left_out += seen.left_out;
    if (seen.left_out > 0)
      left_out.push_back(
          fmt::format("source '{}' left out {} of {} releases", name, seen.left_out, seen.of));
    num_too_soon += seen.too_soon;
    if (seen.too_soon > 0)
      too_soon.push_back(fmt::format(
          "source '{}' marked {} releases urgent too soon: less than {} releases after the "
          "urgent one before; they were ordinary ones",
          name, seen.too_soon, grid.urgent_apart));
    if (phases.size() > grid.clock && phases[grid.clock] != nullptr &&
        !phases[grid.clock]->base_ns())
      unphased.push_back(
          fmt::format("source '{}' was not released: nothing came on its clock, so its phase "
                      "is not known",
                      name));
  }
  for (std::size_t m = 0; m < context_.graph.modules.size(); ++m)
    if (const std::uint64_t count =
            context_.board.module(static_cast<int>(m)).urgent_too_soon.load();
        count > 0) {
      num_too_soon += count;
      too_soon.push_back(fmt::format(
          "XModule '{}' marked {} results urgent too soon: less than {} releases after the urgent "
          "one before; they were ordinary ones",
          context_.graph.modules[m].name, count, context_.grid.marks_apart[m]));
    }
  into.add("release_off_grid", 0, std::move(off_grid));
  into.add("release_left_out", num_left_out, std::move(left_out));
  into.add("urgent_too_soon", num_too_soon, std::move(too_soon));
  const std::uint64_t num_unphased = unphased.size();
  into.add("source_silent", num_unphased, std::move(unphased));
}

}  // namespace xauto::runtime
