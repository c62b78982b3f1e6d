// SPDX-License-Identifier: Apache-2.0
// The backends of GPUs and DLAs over the emulators: a CUcontext is two TSGs, one for each runlist, and
// the second may be opened by the first job only; two cuDLA handles may have one queue. Whether
// xauto.ko tells the drivers or this process itself, the same must be so.
#include "xpu/backend.h"

#include <string>

#include "raw.h"

using xauto::SchedHandle;
using xauto::XPU;

namespace {

using xauto::xpu::Backend;

decltype(&xauto::xpu::make_kernel_queue) make_backend;

std::unique_ptr<Backend> gpu(xauto::ContextCounts& counts) {
  auto backend = make_backend({"gpu0", XPU::GPU, 0});
  if (!backend) ksft_exit_fail_msg("%s\n", backend.error().to_string().c_str());
  (*backend)->count_in(counts);
  return std::move(*backend);
}

/// As a worker calls an `init` that does `what`.
template <class What>
xauto::Status init(Backend& backend, const SchedHandle& handle, What what) {
  const auto around = backend.before_init();
  what();
  return backend.attach(handle);
}
xauto::Status init(Backend& backend, const SchedHandle& handle) {
  return init(backend, handle, [] {});
}

/// A TSG that has a channel, so that it can be suspended.
struct Tsg {
  raw::UniqueFd tsg, channel;
  void open(int runlist = 0) {
    tsg = raw::tsg();
    channel = raw::channel(runlist);
    (void)raw::bind(tsg, channel);
  }
  void close() {
    tsg.reset();
    channel.reset();
  }
};

/// How many TSGs and DLA queues are suspended with it; -1: it is refused.
int suspended_with(Backend& backend, const SchedHandle& handle) {
  if (!backend.preempt(handle)) return -1;
  const int suspended = guest::suspended();
  return backend.restore(handle) && guest::suspended() == 0 ? suspended : -2;
}

bool says(const xauto::ContextCounts& counts, const std::string& part) {
  bool said = false;
  counts.each([&](const char*, std::uint32_t count, const char* what) {
    said = said || (count > 0 && guest::has(std::to_string(count) + " " + what, part));
  });
  return said;
}

/// cudart's context, made by any library before `init`; and one that make_context() knows.
void made_before() {
  xauto::ContextCounts counts;
  const auto backend = gpu(counts);
  int library = 0, later = 0, mine = 0, other = 0;
  const SchedHandle primary = SchedHandle::cuda_context(&library);
  const SchedHandle second = SchedHandle::cuda_context(&mine);
  const SchedHandle third = SchedHandle::cuda_context(&other);
  Tsg compute, copies, known, known_too, late;
  compute.open();
  copies.open(1);
  const SchedHandle returned = xauto::make_context([&] {
    known.open();
    (void)xauto::make_context([&] {
      known_too.open();
      return third;
    });
    late.open(1);
    return second;
  });
  ksft_test_result(returned == second && init(*backend, second).has_value() &&
                       init(*backend, third).has_value() && counts.assumed == 0,
                   "contexts of make_context() are known\n");
  ksft_test_result(
      suspended_with(*backend, second) == 2 && suspended_with(*backend, third) == 1,
      "each is suspended with what it has opened, though one was made within the other\n");
  ksft_test_result(
      init(*backend, primary).has_value() && counts.assumed == 1 && says(counts, "assumed"),
      "a context from before gets what is nobody's, and that is told\n");
  ksft_test_result(suspended_with(*backend, primary) == 2, "and is suspended whole\n");
  ksft_test_result(init(*backend, primary).has_value() && counts.assumed == 1,
                   "a second stage on it is told nothing new\n");

  xauto::ContextCounts others;
  const auto neighbour = gpu(others);
  ksft_test_result(
      init(*neighbour, primary).has_value() && suspended_with(*neighbour, primary) == -1 &&
          suspended_with(*backend, primary) == -1 && others.shared == 1 && counts.shared == 1,
      "one context of two modules is not suspended: both would wait\n");

  // It is closed, and another opened, as cudaDeviceReset does.
  Tsg again;
  again.open();
  compute.close();
  copies.close();
  const SchedHandle renewed = SchedHandle::cuda_context(&later);
  ksft_test_result(init(*backend, renewed).has_value() && suspended_with(*backend, renewed) == 1 &&
                       counts.assumed == 2,
                   "closed and made anew it gets what is nobody's then\n");

  const xauto::Status refused = init(*backend, SchedHandle::cuda_context(&counts));
  ksft_test_result(!refused &&
                       guest::has(refused.error().to_string(), "and so was that of another") &&
                       guest::has(refused.error().to_string(), "make_context"),
                   "a second context from before is refused, and the error says how it is done\n");
  ksft_test_result(
      suspended_with(*backend, renewed) == -1 && suspended_with(*backend, second) == 2,
      "the first may have the second's: it is not suspended any more, the others are\n");
  ksft_test_result(!init(*backend, renewed).has_value(), "and no later `init` gets it\n");
  counts.unclaimed = 0;
  backend->admitted(second, true);
  backend->finishing(second, true);
  ksft_test_result(counts.unclaimed == 1, "what it had is nobody's now, and counted\n");
}

/// The library's context is there, too; nobody asks for it.
void beside() {
  xauto::ContextCounts counts;
  const auto backend = gpu(counts);
  int context = 0, other = 0;
  const SchedHandle handle = SchedHandle::cuda_context(&context);
  const SchedHandle made = SchedHandle::cuda_context(&other);
  Tsg library, compute, copies;
  library.open();
  const bool attached = init(*backend, handle, [&] { compute.open(); }).has_value();
  backend->admitted(handle, true);
  (void)xauto::make_context([&] {
    copies.open(1);
    backend->finishing(handle, true);
    return made;
  });
  ksft_test_result(attached && suspended_with(*backend, handle) == 1,
                   "what is made while a stage ends is not taken for the stage's\n");
  backend->admitted(handle, true);
  backend->finishing(handle, true);
  ksft_test_result(counts.unclaimed == 1 && counts.assumed == 0,
                   "a context that no `init` returns is counted, once\n");
  ksft_test_result(init(*backend, made).has_value() && suspended_with(*backend, made) == 1,
                   "and what was made meanwhile is suspended with its own handle\n");
}

/// The first job opens what the context needs for copies; nobody tells the runtime.
void opened_late() {
  xauto::ContextCounts counts;
  const auto backend = gpu(counts);
  int context = 0, neighbour = 0;
  const SchedHandle handle = SchedHandle::cuda_context(&context);
  const SchedHandle other = SchedHandle::cuda_context(&neighbour);
  Tsg compute, theirs;
  const bool attached = init(*backend, handle, [&] { compute.open(); }).has_value();
  ksft_test_result(attached && init(*backend, other, [&] { theirs.open(); }).has_value() &&
                       counts.incomplete == 2,
                   "contexts are not complete before each has run once\n");
  (void)backend->preempt(handle);
  (void)backend->restore(handle);
  ksft_test_result(counts.partial == 0, "a suspension before that has left nothing out yet\n");

  backend->admitted(handle, true);
  const raw::UniqueFd copies = raw::tsg(), copier = raw::channel(1);
  (void)raw::bind(copies, copier);
  backend->finishing(handle, true);
  ksft_test_result(backend->preempt(handle).has_value() && guest::suspended() == 2,
                   "what the first job opened is suspended with its context\n");
  ksft_test_result(backend->restore(handle).has_value() && guest::suspended() == 0 &&
                       counts.incomplete == 1 && counts.partial == 1 && counts.unclaimed == 0,
                   "and resumed; the context is complete, the suspension before that is counted\n");

  // While it is suspended: its execution thread may be anywhere.
  backend->admitted(other, true);
  (void)backend->preempt(other);
  const raw::UniqueFd more = raw::tsg(), copier_too = raw::channel(1);
  (void)raw::bind(more, copier_too);
  backend->finishing(other, true);
  ksft_test_result(guest::suspended() == 2,
                   "what a suspended context opens is suspended at once\n");
  (void)backend->restore(other);
  ksft_test_result(guest::suspended() == 0 && counts.incomplete == 0, "and resumed\n");

  backend->admitted(handle, true);
  backend->admitted(other, true);
  const raw::UniqueFd whose = raw::tsg();
  backend->finishing(handle, true);
  backend->finishing(other, true);
  ksft_test_result(counts.unclaimed == 1, "what appears while two run is nobody's, and counted\n");

  // The first preempts the second in its first run, when that has opened what it needs.
  int third = 0;
  const SchedHandle held = SchedHandle::cuda_context(&third);
  Tsg base, grown;
  const bool made = init(*backend, held, [&] { base.open(); }).has_value();
  const unsigned unclaimed = counts.unclaimed;  // those of before are told again after an `init`
  const unsigned partial = counts.partial;
  backend->admitted(held, true);
  Tsg early;
  early.open();
  ksft_test_result(suspended_with(*backend, held) == 2,
                   "a first run is suspended with what it has opened\n");
  grown.open(1);
  for (int i = 0; i < 2; ++i) {
    backend->admitted(handle, false);
    backend->finishing(handle, false);
  }
  backend->finishing(held, true);
  ksft_test_result(made && counts.unclaimed == unclaimed + 1 && counts.partial == partial + 1 &&
                       suspended_with(*backend, held) == 3,
                   "a first run that is preempted keeps what it opened before\n");

  // A complete context is looked at every 250 ms: until then nobody knows what it has opened.
  const auto run_one = [&](bool opens) {
    guest::sleep_ms(300);
    backend->admitted(handle, false);
    const raw::UniqueFd late = opens ? raw::tsg() : raw::UniqueFd();
    (void)backend->preempt(handle);
    (void)backend->restore(handle);
    backend->finishing(handle, false);
  };
  const unsigned before = counts.partial;
  run_one(false);
  ksft_test_result(counts.partial == before, "a suspension that left nothing out is not\n");
  run_one(true);
  ksft_test_result(counts.partial == before + 1,
                   "one that came after its stage had opened more is\n");
}

/// A library may close a TSG's descriptor: its channels keep the TSG, and nothing suspends it.
void behind_no_descriptor() {
  xauto::ContextCounts counts;
  const auto backend = gpu(counts);
  int context = 0;
  const SchedHandle handle = SchedHandle::cuda_context(&context);
  Tsg compute, swept, hidden, hidden_too;
  const bool attached = init(*backend, handle, [&] { compute.open(); }).has_value();
  const auto run_one = [&] {
    backend->admitted(handle, true);
    backend->finishing(handle, true);
  };
  hidden.open(1);
  hidden_too.open(1);
  swept.open();
  run_one();  // which registers it, so that xauto.ko keeps it for a moment
  counts.unclaimed = 0;
  for (Tsg* closed : {&hidden, &hidden_too, &swept}) closed->tsg.reset();
  swept.close();
  {
    const raw::UniqueFd theirs = raw::sched();
    run_one();
    guest::sleep_ms(2100);
    run_one();
    ksft_test_result(
        attached && counts.unclaimed == 0,
        "while somebody else has the sched node, the descriptors are all that is known\n");
  }
  run_one();
  ksft_test_result(counts.unclaimed == 0,
                   "what is behind no descriptor may have been closed just now\n");
  guest::sleep_ms(2100);
  run_one();
  run_one();
  ksft_test_result(counts.unclaimed == 2 && says(counts, "they are not suspended"),
                   "2 s later it is counted as nobody's, once\n");
  {
    const raw::UniqueFd theirs = raw::sched();
    run_one();
  }
  run_one();
  guest::sleep_ms(2100);
  run_one();
  ksft_test_result(counts.unclaimed == 2,
                   "and not again when nvgpu has not said it for a moment\n");
  hidden.close();
  hidden_too.close();
  run_one();
  ksft_test_result(counts.unclaimed == 2 && suspended_with(*backend, handle) == 1,
                   "the context itself is suspended as before\n");
}

/// nvdla's node is opened once, whatever cuDLA makes of it.
void one_dla_queue() {
  xauto::ContextCounts counts;
  auto backend = make_backend({"dla0", XPU::DLA, 0});
  if (!backend) ksft_exit_fail_msg("%s\n", backend.error().to_string().c_str());
  (*backend)->count_in(counts);
  int first = 0, second = 0;
  raw::UniqueFd queue;
  const auto open = [&] {
    queue = raw::dla();
    (void)raw::call(queue.get(), NVDLA_IOCTL_ALLOC_QUEUE);
  };
  const SchedHandle one = SchedHandle::cudla_device(&first);
  const SchedHandle two = SchedHandle::cudla_device(&second);
  ksft_test_result(init(**backend, one, open).has_value() && suspended_with(**backend, one) == 1,
                   "a cuDLA handle is suspended\n");
  ksft_test_result(init(**backend, two).has_value(), "a second one of the process is registered\n");
  ksft_test_result(!(*backend)->preempt(two) && !(*backend)->preempt(one) &&
                       guest::suspended() == 0 && counts.shared == 2,
                   "neither is suspended then, for that would hold up the other\n");
}

/// Whoever feeds it was away for longer than the watchdog allows.
void starved() {
  xauto::ContextCounts counts;
  make_backend = xauto::xpu::make_kernel_queue;
  const auto backend = gpu(counts);
  int context = 0;
  const SchedHandle handle = SchedHandle::cuda_context(&context);
  Tsg compute;
  ksft_test_result(init(*backend, handle, [&] { compute.open(); }).has_value() &&
                       backend->preempt(handle).has_value() && guest::suspended() == 1 &&
                       guest::eventually([] { return guest::suspended() == 0; }),
                   "what was suspended runs when its watchdog has bitten\n");
  const auto fed = backend->still_wanted();
  ksft_test_result(
      !fed && fed.error().code == xauto::ErrorCode::kTimeout && guest::suspended() == 1,
      "who feeds it then is told so, and suspends it again\n");
  ksft_test_result(backend->still_wanted().has_value() && backend->restore(handle).has_value() &&
                       guest::suspended() == 0,
                   "once\n");
}

/// Two TSGs, told through one call or through several.
void whole() {
  xauto::ContextCounts counts;
  const auto backend = gpu(counts);
  int context = 0;
  const SchedHandle handle = SchedHandle::cuda_context(&context);
  Tsg compute, copies;
  const auto open = [&] {
    compute.open();
    copies.open(1);
  };
  ksft_test_result(init(*backend, handle, open).has_value() &&
                       backend->preempt(handle).has_value() && guest::suspended() == 2,
                   "a context of two TSGs is suspended whole\n");
  (void)raw::call(compute.tsg.get(), NVGPU_IOCTL_TSG_ENABLE);
  const bool enabled = guest::suspended() < 2;
  ksft_test_result(guest::eventually([&] {
                     return backend->still_wanted().has_value() && guest::suspended() == 2;
                   }),
                   "what the driver enables meanwhile%s is suspended again\n",
                   enabled ? "" : " (too late)");
  ksft_test_result(backend->restore(handle).has_value() && guest::suspended() == 0,
                   "and resumed\n");
  raw::gpu_parameter("yield_us", "300000");
  (void)raw::work(copies.channel, 60000);
  (void)guest::eventually([] { return guest::has(guest::gpu_state(), "current=1"); });
  const auto refused = backend->preempt(handle);
  ksft_test_result(!refused && refused.error().code == xauto::ErrorCode::kTimeout,
                   "one that does not leave is an error\n");
  ksft_test_result(guest::suspended() == 0, "and all of the context runs\n");
  raw::gpu_parameter("yield_us", "0");
}

}  // namespace

int main() {
  const std::pair<const char*, decltype(make_backend)> ways[] = {
      {"xauto.ko", xauto::xpu::make_kernel_queue}, {"own", xauto::xpu::make_own_queue}};
  setlinebuf(stdout);
  ksft_print_header();
  ksft_set_plan(79);
  for (const auto& [name, make] : ways) {
    ksft_print_msg("%s\n", name);
    make_backend = make;
    for (const auto part :
         {made_before, beside, opened_late, behind_no_descriptor, one_dla_queue, whole}) {
      part();
      (void)xauto::make_context([] { return SchedHandle(); });  // sees that all were closed
    }
  }
  starved();
  ksft_finished();
}
