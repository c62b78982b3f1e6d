// SPDX-License-Identifier: Apache-2.0
// The backend of GPUs and DLAs over the emulators: a CUcontext is two TSGs, one for each runlist, and
// the second may be opened by the first job only; two cuDLA handles may have one queue.
#include "xpu/backend.h"

#include "raw.h"

using xauto::SchedHandle;
using xauto::XPU;

namespace {

/// The first job opens what the context needs for copies; nobody tells the runtime.
void opened_late() {
  xauto::ContextCounts counts;
  auto backend = xauto::xpu::make_kernel_queue({"gpu0", XPU::GPU, 0});
  if (!backend) ktap_bail("%s", backend.error().to_string().c_str());
  (*backend)->count_in(counts);
  int context = 0, neighbour = 0;
  const SchedHandle handle = SchedHandle::cuda_context(&context);
  const SchedHandle other = SchedHandle::cuda_context(&neighbour);
  (void)(*backend)->before_init();
  const raw::UniqueFd compute = raw::tsg(), kernels = raw::channel();
  (void)raw::bind(compute, kernels);
  const bool attached = (*backend)->attach(handle).has_value();
  (void)(*backend)->before_init();
  const raw::UniqueFd theirs = raw::tsg(), their_kernels = raw::channel();
  (void)raw::bind(theirs, their_kernels);
  ktap_test(attached && (*backend)->attach(other).has_value() && counts.incomplete == 2,
            "contexts are not complete before each has run once");
  (void)(*backend)->preempt(handle);
  (void)(*backend)->restore(handle);
  ktap_test(counts.partial == 0, "a suspension before that has left nothing out yet");

  (*backend)->admitted(handle, true);
  const raw::UniqueFd copies = raw::tsg(), copier = raw::channel(1);
  (void)raw::bind(copies, copier);
  (*backend)->finishing(handle, true);
  ktap_test((*backend)->preempt(handle).has_value() && guest::suspended() == 2,
            "what the first job opened is suspended with its context");
  ktap_test((*backend)->restore(handle).has_value() && guest::suspended() == 0 &&
                counts.incomplete == 1 && counts.partial == 1 && counts.unclaimed == 0,
            "and resumed; the context is complete, the suspension before that is counted");

  // While it is suspended: its execution thread may be anywhere.
  (*backend)->admitted(other, true);
  (void)(*backend)->preempt(other);
  const raw::UniqueFd more = raw::tsg(), copier_too = raw::channel(1);
  (void)raw::bind(more, copier_too);
  (*backend)->finishing(other, true);
  ktap_test(guest::suspended() == 2, "what a suspended context opens is suspended at once");
  (void)(*backend)->restore(other);
  ktap_test(guest::suspended() == 0 && counts.incomplete == 0, "and resumed");

  (*backend)->admitted(handle, true);
  (*backend)->admitted(other, true);
  const raw::UniqueFd whose = raw::tsg();
  (*backend)->finishing(handle, true);
  (*backend)->finishing(other, true);
  ktap_test(counts.unclaimed == 1, "what appears while two run is nobody's, and counted");

  // A complete context is looked at every 250 ms: until then nobody knows what it has opened.
  const auto run_one = [&](bool opens) {
    guest::sleep_ms(300);
    (*backend)->admitted(handle, false);
    const raw::UniqueFd late = opens ? raw::tsg() : raw::UniqueFd();
    (void)(*backend)->preempt(handle);
    (void)(*backend)->restore(handle);
    (*backend)->finishing(handle, false);
  };
  const unsigned before = counts.partial;
  run_one(false);
  ktap_test(counts.partial == before, "a suspension that left nothing out is not");
  run_one(true);
  ktap_test(counts.partial == before + 1, "one that came after its stage had opened more is");
}

/// nvdla's node is opened once, whatever cuDLA makes of it.
void one_dla_queue() {
  xauto::ContextCounts counts;
  auto backend = xauto::xpu::make_kernel_queue({"dla0", XPU::DLA, 0});
  if (!backend) ktap_bail("%s", backend.error().to_string().c_str());
  (*backend)->count_in(counts);
  int first = 0, second = 0;
  (void)(*backend)->before_init();
  const raw::UniqueFd queue = raw::dla();
  (void)raw::call(queue.get(), NVDLA_IOCTL_ALLOC_QUEUE);
  const SchedHandle one = SchedHandle::cudla_device(&first);
  const SchedHandle two = SchedHandle::cudla_device(&second);
  ktap_test((*backend)->attach(one).has_value() && (*backend)->preempt(one).has_value() &&
                guest::suspended() == 1 && (*backend)->restore(one).has_value(),
            "a cuDLA handle is suspended");
  (void)(*backend)->before_init();
  ktap_test((*backend)->attach(two).has_value(), "a second one of the process is registered");
  ktap_test(!(*backend)->preempt(two) && !(*backend)->preempt(one) && guest::suspended() == 0 &&
                counts.shared == 2,
            "neither is suspended then, for that would hold up the other");
}

}  // namespace

int main() {
  ktap_plan(16);
  opened_late();
  one_dla_queue();
  auto backend = xauto::xpu::make_kernel_queue({"gpu0", XPU::GPU, 0});
  if (!backend) ktap_bail("%s", backend.error().to_string().c_str());
  (void)(*backend)->before_init();
  int context = 0;
  const SchedHandle handle = SchedHandle::cuda_context(&context);
  const raw::UniqueFd compute = raw::tsg(), copies = raw::tsg(), kernels = raw::channel(),
                      copier = raw::channel(1);
  (void)raw::bind(compute, kernels);
  (void)raw::bind(copies, copier);
  ktap_test((*backend)->attach(handle).has_value() && (*backend)->preempt(handle).has_value() &&
                guest::suspended() == 2,
            "a context of two TSGs is suspended whole");
  ktap_test((*backend)->restore(handle).has_value() && guest::suspended() == 0, "and resumed");
  raw::gpu_parameter("yield_us", "300000");
  (void)raw::work(copier, 60000);
  (void)guest::eventually([] { return guest::has(guest::gpu_state(), "current=1"); });
  const auto refused = (*backend)->preempt(handle);
  ktap_test(!refused && refused.error().code == xauto::ErrorCode::kTimeout,
            "one that does not leave is an error");
  ktap_test(guest::suspended() == 0, "and all of the context runs");
  raw::gpu_parameter("yield_us", "0");
  return ktap_exit();
}
