// SPDX-License-Identifier: Apache-2.0
#include "kernel/tracer.h"

#include <bit>
#include <filesystem>

#include <unistd.h>

#include "kernel/libbpf/session.h"
#include "kernel/trace_format.h"

#include "xauto_trace.skel.h"
#include "xauto_trace_tp.skel.h"

namespace xauto::kernel {

struct Tracer::Attached {
  std::function<void()> destroy = [] {};
  ring_buffer* ring = nullptr;
  MappedMap hist, cpus, losses;
  std::uint32_t xnodes = 0;
  const std::function<void(const xauto_bpf_event&)>* sink = nullptr;
  std::string folder;  ///< where we have pinned; empty: nowhere

  template <class Skeleton>
  [[nodiscard]] Status load(Skeleton* object, const RunMaps& maps, const TracerOptions& options);

  ~Attached() {
    if (!folder.empty())
      for (const char* name : {"events", "pipe", "hist", "cpus", "losses"})
        unlink((folder + "/" + name).c_str());
    ring_buffer__free(ring);
    destroy();
  }
};

Tracer::Tracer() = default;
Tracer::Tracer(Tracer&&) noexcept = default;
Tracer::~Tracer() = default;

namespace {

/// Where a record has what the programs read of it.
Status place(xauto_trace_tp& object) {
  constexpr std::uint32_t kNumber = 4, kLong = 8, kName = 16;
  auto& knobs = *object.rodata;
  struct Wanted {
    const char *event, *field;
    std::uint32_t size;
    unsigned* at;
  };
  std::uint32_t state_size = kLong;
  for (const Wanted& wanted :
       {Wanted{"sched/sched_switch", "prev_pid", kNumber, &knobs.prev_pid_at},
        Wanted{"sched/sched_switch", "prev_state", 0, &knobs.prev_state_at},
        Wanted{"sched/sched_switch", "next_pid", kNumber, &knobs.next_pid_at},
        Wanted{"sched/sched_switch", "next_comm", kName, &knobs.next_comm_at},
        Wanted{"sched/sched_wakeup", "pid", kNumber, &knobs.woken_pid_at},
        Wanted{"sched/sched_migrate_task", "pid", kNumber, &knobs.moved_pid_at},
        Wanted{"sched/sched_migrate_task", "dest_cpu", kNumber, &knobs.moved_cpu_at},
        Wanted{"sched/sched_process_exit", "pid", kNumber, &knobs.ended_pid_at}}) {
    XAUTO_ASSIGN(const std::string format, trace_format(wanted.event));
    const auto field = trace_field(format, wanted.field);
    if (!field || (wanted.size == 0 ? field->size != kNumber && field->size != kLong
                                    : field->size != wanted.size))
      return fail(ErrorCode::kUnavailable, std::string("this kernel's tracepoint ") + wanted.event +
                                               " has no '" + wanted.field + "' as we know it");
    *wanted.at = field->at;
    if (wanted.size == 0) state_size = field->size;
  }
  knobs.prev_state_is_long = state_size == kLong;
  return {};
}

Status place(xauto_trace&) {
  return {};  // by the kernel's BTF
}

}  // namespace

template <class Skeleton>
Status Tracer::Attached::load(Skeleton* object, const RunMaps& maps, const TracerOptions& options) {
  if (object == nullptr) return libbpf_failed("opening the tracer", errno);
  destroy = [object] { Skeleton::destroy(object); };
  object->rodata->record_events = options.events;
  XAUTO_TRY(place(*object));
  auto& of = object->maps;
  for (bpf_map* map : {of.head, of.slots, of.threads}) XAUTO_TRY(reuse(map, maps));
  xnodes = maps.head().xnodes;
  bpf_map__set_max_entries(of.hist, xnodes);
  bpf_map__set_max_entries(of.cpus, static_cast<__u32>(sysconf(_SC_NPROCESSORS_CONF)));
  bpf_map__set_max_entries(of.events,
                           std::bit_ceil(std::max(options.ring_bytes, std::uint32_t{4096})));
  const VerifierLog verifier(object->obj);
  const int load_error = Skeleton::load(object);
  verifier.write();
  if (load_error != 0) return libbpf_failed("the kernel did not accept the tracer", load_error);
  if (const int error = Skeleton::attach(object); error != 0)
    return libbpf_failed("attaching the tracer", error);
  const auto map_array = [](MappedMap& into, const bpf_map* map, std::size_t size) -> Status {
    XAUTO_ASSIGN(into, MappedMap::map(bpf_map__fd(map), size, false));
    return {};
  };
  XAUTO_TRY(map_array(hist, of.hist, sizeof(xauto_bpf_hist)));
  XAUTO_TRY(map_array(cpus, of.cpus, sizeof(xauto_bpf_cpu)));
  XAUTO_TRY(map_array(losses, of.losses, sizeof(xauto_bpf_losses)));
  ring = ring_buffer__new(
      bpf_map__fd(of.events),
      [](void* context, void* data, size_t size) -> int {
        if (size >= sizeof(xauto_bpf_event))
          (*static_cast<Attached*>(context)->sink)(*static_cast<const xauto_bpf_event*>(data));
        return 0;
      },
      this, nullptr);
  if (ring == nullptr) return libbpf_failed("mapping the ring buffer", errno);
  if (!options.pin) return {};
  folder = RunMaps::folder(maps.run());
  XAUTO_TRY(maps.pin(bpf_map__fd(of.events), "events"));
  XAUTO_TRY(maps.pin(bpf_map__fd(of.pipe), "pipe"));
  XAUTO_TRY(maps.pin(bpf_map__fd(of.hist), "hist"));
  XAUTO_TRY(maps.pin(bpf_map__fd(of.cpus), "cpus"));
  return maps.pin(bpf_map__fd(of.losses), "losses");
}

Result<Tracer> Tracer::attach(const RunMaps& maps, const TracerOptions& options) {
  Tracer tracer;
  tracer.attached_ = std::make_unique<Attached>();
  const LibbpfMessages messages;
  std::error_code ignored;
  XAUTO_TRY(std::filesystem::exists("/sys/kernel/btf/vmlinux", ignored)
                ? tracer.attached_->load(xauto_trace::open(), maps, options)
                : tracer.attached_->load(xauto_trace_tp::open(), maps, options));
  return tracer;
}

Result<std::size_t> Tracer::read(int timeout_ms,
                                 const std::function<void(const xauto_bpf_event&)>& sink) {
  attached_->sink = &sink;
  const int count = ring_buffer__poll(attached_->ring, timeout_ms);
  attached_->sink = nullptr;
  if (count == -EINTR) return std::size_t{0};
  if (count < 0) return libbpf_failed("reading the ring buffer", count);
  return static_cast<std::size_t>(count);
}

xauto_bpf_losses Tracer::losses() const {
  return *attached_->losses.as<xauto_bpf_losses>();
}

std::vector<xauto_bpf_hist> Tracer::histograms() const {
  const auto* hist = attached_->hist.as<xauto_bpf_hist>();
  return {hist, hist + attached_->xnodes};
}

std::vector<xauto_bpf_cpu> Tracer::cpus() const {
  const auto* cpus = attached_->cpus.as<xauto_bpf_cpu>();
  return {cpus, cpus + attached_->cpus.size()};
}

}  // namespace xauto::kernel
