// SPDX-License-Identifier: Apache-2.0
#include "processes/board.h"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <new>

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include "base/counter.h"
#include "base/memory_file.h"
#include "base/utf8.h"
#include "model/app.h"
#include "model/deployment.h"
#include "model/parameter.h"
#include "model/scenario.h"
#include "session/changes.h"
#include "session/distribution.h"

namespace xauto::runtime {
namespace {

constexpr std::uint32_t kMaxFlows = kMaxChains + 1;
constexpr std::uint32_t kBoardMagic = 0x58424f53;  // "XBOS"; another one with each layout

std::size_t bytes_of(const BoardShape& shape) {
  return sizeof(BoardHeader) + shape.processes * sizeof(ProcessLine) +
         shape.modules * sizeof(ModuleLine) + shape.nodes * sizeof(XNodeLine) +
         shape.flows * sizeof(FlowLine) + shape.parameters * sizeof(ParameterLine) +
         shape.scenarios * sizeof(ScenarioLine) + shape.xpus * sizeof(XpuLine) +
         shape.crossings * sizeof(CrossingLine);
}

void fill(void* memory, const BoardShape& s) {
  auto* header = new (memory) BoardHeader;
  header->magic = kBoardMagic;
  header->processes = s.processes;
  header->modules = s.modules;
  header->nodes = s.nodes;
  header->flows = s.flows;
  header->parameters = s.parameters;
  header->scenarios = s.scenarios;
  header->xpus = s.xpus;
  header->crossings = s.crossings;
  auto* lines = reinterpret_cast<ProcessLine*>(header + 1);
  for (std::uint32_t p = 0; p < s.processes; ++p) (new (lines + p) ProcessLine)->stand_in.store(p);
  auto* counts = reinterpret_cast<ModuleLine*>(lines + s.processes);
  for (std::uint32_t m = 0; m < s.modules; ++m) new (counts + m) ModuleLine;
  auto* xnodes = reinterpret_cast<XNodeLine*>(counts + s.modules);
  for (std::uint32_t n = 0; n < s.nodes; ++n) new (xnodes + n) XNodeLine;
  auto* flows = reinterpret_cast<FlowLine*>(xnodes + s.nodes);
  for (std::uint32_t f = 0; f < s.flows; ++f) new (flows + f) FlowLine;
  auto* parameters = reinterpret_cast<ParameterLine*>(flows + s.flows);
  for (std::uint32_t p = 0; p < s.parameters; ++p) new (parameters + p) ParameterLine;
  auto* scenarios = reinterpret_cast<ScenarioLine*>(parameters + s.parameters);
  for (std::uint32_t k = 0; k < s.scenarios; ++k) new (scenarios + k) ScenarioLine;
  auto* xpus = reinterpret_cast<XpuLine*>(scenarios + s.scenarios);
  for (std::uint32_t x = 0; x < s.xpus; ++x) new (xpus + x) XpuLine;
  auto* crossings = reinterpret_cast<CrossingLine*>(xpus + s.xpus);
  for (std::uint32_t c = 0; c < s.crossings; ++c) new (crossings + c) CrossingLine;
}

}  // namespace

Board::Board(void* memory, std::size_t bytes, bool mapped, const BoardShape& shape)
    : memory_(memory),
      bytes_(bytes),
      mapped_(mapped),
      shape_(shape),
      header_(static_cast<BoardHeader*>(memory)),
      processes_(reinterpret_cast<ProcessLine*>(header_ + 1)),
      modules_(reinterpret_cast<ModuleLine*>(processes_ + shape.processes)),
      xnodes_(reinterpret_cast<XNodeLine*>(modules_ + shape.modules)),
      flows_(reinterpret_cast<FlowLine*>(xnodes_ + shape.nodes)),
      parameters_(reinterpret_cast<ParameterLine*>(flows_ + shape.flows)),
      scenarios_(reinterpret_cast<ScenarioLine*>(parameters_ + shape.parameters)),
      xpus_(reinterpret_cast<XpuLine*>(scenarios_ + shape.scenarios)),
      crossings_(reinterpret_cast<CrossingLine*>(xpus_ + shape.xpus)) {}

Board::~Board() {
  if (mapped_)
    munmap(memory_, bytes_);
  else
    ::operator delete (memory_, std::align_val_t{64});
}

std::shared_ptr<Board> Board::local(const BoardShape& shape) {
  const std::size_t bytes = bytes_of(shape);
  void* memory = ::operator new (bytes, std::align_val_t{64});
  fill(memory, shape);
  return std::shared_ptr<Board>(new Board(memory, bytes, false, shape));
}

Result<std::shared_ptr<Board>> Board::create(const BoardShape& shape, UniqueFd& fd) {
  if (shape.processes == 0 || shape.processes > kMaxProcesses || shape.modules > kMaxXNodes ||
      shape.nodes > kMaxXNodes || shape.flows > kMaxFlows || shape.parameters > kMaxParameters ||
      shape.scenarios > kMaxScenarios || shape.xpus > kMaxXpus || shape.crossings > kMaxXNodes)
    return fail(ErrorCode::kInvalid, std::to_string(shape.processes) + " processes and " +
                                         std::to_string(shape.modules) + " modules are too many");
  const std::size_t bytes = bytes_of(shape);
  if (!fd) fd = private_memfd("xauto-board", MFD_CLOEXEC | MFD_ALLOW_SEALING);
  if (!fd)
    return fail(ErrorCode::kIo, std::string("cannot make shared memory: ") + strerror(errno));
  XAUTO_TRY(seal_memory(fd.get(), bytes));
  void* memory =
      mmap(nullptr, bytes, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_POPULATE, fd.get(), 0);
  if (memory == MAP_FAILED)
    return fail(ErrorCode::kIo, std::string("cannot map shared memory: ") + strerror(errno));
  fill(memory, shape);
  return std::shared_ptr<Board>(new Board(memory, bytes, true, shape));
}

Result<std::shared_ptr<Board>> Board::map(int fd, const BoardShape& shape) {
  const std::size_t bytes = bytes_of(shape);
  struct stat status {};
  if (fstat(fd, &status) != 0 || static_cast<std::size_t>(status.st_size) < bytes)
    return fail(ErrorCode::kInvalid, "the app's shared memory is cut short");
  void* memory = mmap(nullptr, bytes, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_POPULATE, fd, 0);
  if (memory == MAP_FAILED)
    return fail(ErrorCode::kIo, std::string("cannot map shared memory: ") + strerror(errno));
  auto board = std::shared_ptr<Board>(new Board(memory, bytes, true, shape));
  const BoardHeader& h = *board->header_;
  if (h.magic != kBoardMagic || h.processes != shape.processes || h.modules != shape.modules ||
      h.nodes != shape.nodes || h.flows != shape.flows || h.parameters != shape.parameters ||
      h.scenarios != shape.scenarios || h.xpus != shape.xpus || h.crossings != shape.crossings)
    return fail(ErrorCode::kInvalid, "the app's shared memory is another app's", {},
                "all processes of an app must be of one build");
  return board;
}

bool Board::busy() const {
  return std::any_of(modules_, modules_ + header_->modules,
                     [](const ModuleLine& line) { return line.in_flight.load() != 0; });
}

Result<std::shared_ptr<const Board>> Board::observe(int fd) {
  XAUTO_ASSIGN(std::shared_ptr<const Board> board, look(fd, PROT_READ));
  return board;
}

Result<std::shared_ptr<Board>> Board::steer(int fd) {
  return look(fd, PROT_READ | PROT_WRITE);
}

Result<std::shared_ptr<Board>> Board::look(int fd, int protection) {
  struct stat status {};
  // Its size cannot change once it is sealed, and what is sealed is filled in or about to be.
  const int seals = fcntl(fd, F_GET_SEALS);
  if (seals < 0 || (seals & F_SEAL_SHRINK) == 0 || fstat(fd, &status) != 0 ||
      static_cast<std::size_t>(status.st_size) < sizeof(BoardHeader))
    return fail(ErrorCode::kUnavailable, "the app has not started yet");
  const auto bytes = static_cast<std::size_t>(status.st_size);
  void* memory = mmap(nullptr, bytes, protection, MAP_SHARED, fd, 0);
  if (memory == MAP_FAILED)
    return fail(ErrorCode::kIo, std::string("cannot map shared memory: ") + strerror(errno));
  const auto* header = static_cast<const BoardHeader*>(memory);
  const BoardShape shape{header->processes,  header->modules,   header->nodes, header->flows,
                         header->parameters, header->scenarios, header->xpus,  header->crossings};
  const bool whole =
      header->magic == kBoardMagic && header->told.load(std::memory_order_acquire) != 0 &&
      shape.processes >= 1 && shape.processes <= kMaxProcesses && shape.modules <= kMaxXNodes &&
      shape.nodes <= kMaxXNodes && shape.flows >= 1 && shape.flows <= kMaxFlows &&
      shape.parameters <= kMaxParameters && shape.scenarios <= kMaxScenarios &&
      shape.xpus <= kMaxXpus && shape.crossings <= kMaxXNodes && bytes_of(shape) == bytes;
  if (!whole) {
    munmap(memory, bytes);
    return fail(ErrorCode::kUnavailable, "the app has not started yet");
  }
  return std::shared_ptr<Board>(new Board(memory, bytes, true, shape));
}

void SpannedLine::take(const Spanned& one) {
  if (!nearer(one.us, one.worst_case_us, us_.load(), worst_case_us_.load())) return;
  writes_.fetch_add(1);
  from_.store(one.from);
  to_.store(one.to);
  flow_.store(one.flow);
  us_.store(one.us);
  worst_case_us_.store(one.worst_case_us);
  allowed_us_.store(one.allowed_us);
  writes_.fetch_add(1);
}

std::optional<Spanned> SpannedLine::read() const {
  constexpr int kTries = 1000;  // a write is shorter, unless its thread is preempted or dead
  for (int again = 0; again < kTries; ++again) {
    const std::uint32_t before = writes_.load();
    const Spanned one{from_.load(),          to_.load(),        flow_.load(), us_.load(),
                      worst_case_us_.load(), allowed_us_.load()};
    if (before % 2 != 0 || writes_.load() != before) continue;
    return one.us < 0 ? std::nullopt : std::optional<Spanned>(one);
  }
  return std::nullopt;
}

void FlowLine::add(std::int64_t us, std::int64_t now_ns) {
  add_alone(results);
  add_alone(sum_us, us);
  last_ns.store(now_ns, std::memory_order_relaxed);
  // A run whose first result is late counts from there.
  if (limit_us() > 0 && (us <= limit_us() || in_time_ns.load(std::memory_order_relaxed) == 0))
    in_time_ns.store(now_ns, std::memory_order_relaxed);
  add_alone(latency_us[std::min(Distribution::bucket_of(us), kBuckets - 1)]);
  last_us.store(us, std::memory_order_relaxed);
  if (us > longest_us.load(std::memory_order_relaxed))
    longest_us.store(us, std::memory_order_relaxed);
}

void FlowLine::add_urgent(std::int64_t us) {
  if (us > longest_urgent_us.load(std::memory_order_relaxed))
    longest_urgent_us.store(us, std::memory_order_relaxed);
}

std::string XNodeLine::words_of_asked() const {
  const std::uint32_t times = asked_times.load();
  if (times == 0) return {};
  const std::int64_t now = asked.load();
  const bool key = ordered.load() == static_cast<std::uint32_t>(Ordered::kKey);
  return std::string(key ? "the key" : "the priority") + " of XNode '" + line_name(name) +
         "' was changed by hand, " + std::to_string(times) + (times > 1 ? " times" : " time") +
         (now == kAsPlanned ? "; it is the policy's again"
                            : "; it is " + std::to_string(now) + (key ? " us" : ""));
}

std::string XpuLine::slow_suspensions() const {
  const std::int64_t suspend_us = longest_suspend_ns / 1000, resume_us = longest_resume_ns / 1000;
  if (preempt_us < 0 || suspend_us + resume_us <= preempt_us) return {};
  return "suspending a job's work on " + line_name(name) + " and resuming it took up to " +
         std::to_string(suspend_us) + " us and " + std::to_string(resume_us) +
         " us; the platform file says preempt_us " + std::to_string(preempt_us);
}

namespace {

constexpr std::uint32_t kBeingTold = 1, kTold = 2;

/// The first one's words stay.
void tell_once(std::atomic<std::uint32_t>& told, char (&field)[kBoardNameBytes],
               const std::string& text) {
  std::uint32_t nothing = 0;
  if (!told.compare_exchange_strong(nothing, kBeingTold)) return;
  name_line(field, text);
  told.store(kTold, std::memory_order_release);
}

}  // namespace

void XpuLine::tell_shared(const std::string& with) {
  tell_once(shared, shared_with, with);
}

void XpuLine::tell_crowd(const std::string& by) {
  tell_once(crowd_told, crowd_by, by);
}

std::string CrossingLine::words_of_lost() const {
  const std::uint64_t gone = lost.load(), came = late.load();
  if (gone == 0) return {};
  std::string text = fmt::format(
      "{} of {} messages of XNode '{}' were not here, from '{}' to '{}', by their key + X = {:.3f} "
      "ms",
      gone, gone + messages.load(), line_name(xnode), line_name(from), line_name(to),
      static_cast<double>(x_us) / 1000);
  if (came > 0)
    text += fmt::format(": {} came later, by up to {:.3f} ms", came,
                        static_cast<double>(latest_ns.load()) * 1e-6);
  if (gone > came) text += fmt::format("{} {} never came", came > 0 ? "," : ":", gone - came);
  return text;
}

std::string XpuLine::words_of_sharing() const {
  if (shared.load(std::memory_order_acquire) != kTold) return {};
  return line_name(name) + " does not serve this app alone: " + line_name(shared_with) +
         " has it, too";
}

std::string XpuLine::words_of_crowd() const {
  const std::uint64_t jobs = crowded.load();
  if (jobs == 0) return {};
  const bool known = crowd_told.load(std::memory_order_acquire) == kTold;
  return fmt::format(
      "on {} {} job{} kept to {} WCET, and others than this run had the core for up to {:.2f} ms "
      "of {} time; {}",
      line_name(name), jobs, jobs > 1 ? "s" : "", jobs > 1 ? "their" : "its",
      static_cast<double>(crowded_ns.load()) * 1e-6, jobs > 1 ? "their" : "its",
      known ? "seen there: " + line_name(crowd_by) : "who is not known");
}

std::string XNodeLine::words_of_moved() const {
  if (moved.load() == 0) return {};
  return "the thread that runs XNode '" + line_name(name) + "' of XModule '" + line_name(module) +
         "' was given other CPUs or another scheduling policy than the run gave it";
}

void Board::count_late(std::int64_t ns, bool early) {
  if (early) header_->early.fetch_add(1, std::memory_order_relaxed);
  header_->late.fetch_add(1, std::memory_order_relaxed);
  if (ns > header_->latest_ns.load(std::memory_order_relaxed))
    header_->latest_ns.store(ns, std::memory_order_relaxed);
}

void Board::tell_unkept(const std::string& text) {
  std::memcpy(header_->unkept, text.data(), std::min(text.size(), kBoardTextBytes - 1));
}

std::string Board::unkept() const {
  return for_terminal(valid_utf8({header_->unkept, strnlen(header_->unkept, kBoardTextBytes)}));
}

void name_line(char (&field)[kBoardNameBytes], const std::string& name) {
  std::memcpy(field, name.data(), std::min(name.size(), kBoardNameBytes - 1));
}

std::string line_name(const char (&field)[kBoardNameBytes]) {
  return for_terminal(valid_utf8({field, strnlen(field, kBoardNameBytes)}), false);
}

std::uint64_t Board::settled() const {
  std::uint64_t sum = 0;
  for (std::uint32_t m = 0; m < shape_.modules; ++m) sum += modules_[m].settled();
  return sum;
}

}  // namespace xauto::runtime
