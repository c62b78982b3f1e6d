// SPDX-License-Identifier: Apache-2.0
// The backend of GPUs over the emulator: a CUcontext is two TSGs, one for each runlist.
#include "xpu/backend.h"

#include "raw.h"

using xauto::SchedHandle;
using xauto::XPU;

int main() {
  ktap_plan(4);
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
