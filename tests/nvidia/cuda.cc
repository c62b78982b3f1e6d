// SPDX-License-Identifier: Apache-2.0
#include "cuda.h"

#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <cstring>
#include <deque>
#include <iterator>
#include <map>
#include <memory>
#include <mutex>
#include <utility>
#include <vector>

#include <pthread.h>

#include "fake.h"

struct Kernel {
  std::function<void()> block;
  int left = 1, running = 0;
};
struct CUstream_st {
  CUcontext context = nullptr;
  int priority = 0;                 ///< the greatest is the smallest number
  std::deque<Kernel> kernels = {};  ///< the first one is there until it has ended
  bool capturing = false;
  bool between = false;  ///< a kernel has just ended, and nobody else has had a block since
  fake::Busy busy = {};
};
struct CUctx_st {
  bool primary = false;
  int users = 0;  ///< of a primary one
  std::vector<std::unique_ptr<CUstream_st>> streams = {};
};
struct CUgraph_st {
  std::vector<Kernel> kernels;
};
struct CUgraphExec_st {
  CUcontext context = nullptr;
  std::vector<Kernel> kernels = {};
};

namespace {

struct Memory {
  std::vector<std::byte> bytes;
  CUcontext context;
  bool mapped;  ///< for the GPU
};
std::mutex gpu;                   ///< of all below
std::condition_variable changed;  ///< something was queued, or a block has ended
int busy = 0;                     ///< blocks that run
int units = 0;                    ///< of a Device; 0: there is none
std::size_t turn = 0;             ///< of contexts
std::map<const void*, Memory> memory;
std::vector<std::unique_ptr<CUctx_st>> contexts;
int graphs = 0, failing = -1, priorities = 6;
thread_local std::vector<CUcontext> stack;

/// Of a live context; null: none has such a stream.
CUstream_st* find(CUstream stream) {
  for (const auto& context : contexts)
    for (const auto& one : context->streams)
      if (one.get() == stream) return stream;
  return nullptr;
}
CUctx_st* find(CUcontext context) {
  for (const auto& one : contexts)
    if (one.get() == context) return context;
  return nullptr;
}
std::int64_t now_ns() {
  return std::chrono::nanoseconds(std::chrono::steady_clock::now().time_since_epoch()).count();
}
CUstream_st* next_of(const CUctx_st& context) {
  CUstream_st* next = nullptr;
  for (const auto& stream : context.streams)
    if (!stream->kernels.empty() && stream->kernels.front().left > 0 && !stream->capturing &&
        !stream->between && (next == nullptr || stream->priority < next->priority))
      next = stream.get();
  return next;
}
/// Runs a block of this stream's.
void run_next(CUstream_st& stream, std::unique_lock<std::mutex>& lock) {
  Kernel& kernel = stream.kernels.front();
  --kernel.left;
  ++kernel.running;
  ++busy;
  lock.unlock();
  kernel.block();
  lock.lock();
  --busy;
  if (--kernel.running == 0 && kernel.left == 0) {
    stream.kernels.pop_front();
    stream.between = units > 0 && !stream.kernels.empty();
  }
  if (stream.kernels.empty()) stream.busy.until_ns = now_ns();
  changed.notify_all();
}
/// Those that are between two kernels may go on. `behind`: a block of another stream that came in between.
bool go_on(bool behind) {
  bool any = false;
  for (const auto& context : contexts)
    for (const auto& stream : context->streams) {
      any = any || stream->between;
      stream->busy.waits += behind && stream->between ? 1 : 0;
      stream->between = false;
    }
  return any;
}
void run_unit() {
  const sched_param highest{sched_get_priority_max(SCHED_FIFO)};  // a GPU waits for nobody's core
  (void)pthread_setschedparam(pthread_self(), SCHED_FIFO, &highest);
  std::unique_lock lock(gpu);
  while (units > 0) {
    CUstream_st* next = nullptr;
    for (std::size_t i = 1; i <= contexts.size() && next == nullptr; ++i)
      if ((next = next_of(*contexts[(turn + i) % contexts.size()])) != nullptr)
        turn = (turn + i) % contexts.size();
    if (next != nullptr) {
      (void)go_on(true);
      run_next(*next, lock);
    } else if (!go_on(false)) {
      changed.wait(lock);
    }
  }
}
CUresult create(CUstream* made, unsigned flags, int priority) {
  const std::lock_guard lock(gpu);
  if (stack.empty() || find(stack.back()) == nullptr) return CUDA_ERROR_INVALID_CONTEXT;
  if (flags != CU_STREAM_NON_BLOCKING) return CUDA_ERROR_INVALID_VALUE;
  stack.back()->streams.push_back(
      std::make_unique<CUstream_st>(CUstream_st{stack.back(), priority}));
  *made = stack.back()->streams.back().get();
  return CUDA_SUCCESS;
}
bool queue(CUstream stream, Kernel kernel) {
  if (stack.empty() || find(stream) == nullptr || stream->context != stack.back()) return false;
  if (stream->kernels.empty())
    stream->busy = {now_ns(), 0, busy, units > 0 && busy == units ? 1 : 0};
  stream->kernels.push_back(std::move(kernel));
  changed.notify_all();
  return true;
}

CUresult allocate(void** made, std::size_t bytes, bool mapped) {
  const std::lock_guard lock(gpu);
  if (stack.empty()) return CUDA_ERROR_INVALID_CONTEXT;
  if (bytes == 0) return CUDA_ERROR_INVALID_VALUE;
  Memory block{std::vector<std::byte>(bytes, std::byte{0xAA}), stack.back(), mapped};
  *made = block.bytes.data();
  memory.emplace(*made, std::move(block));
  return CUDA_SUCCESS;
}
CUresult release(const void* block) {
  const std::lock_guard lock(gpu);
  const auto found = memory.find(block);
  if (found == memory.end()) return CUDA_ERROR_INVALID_VALUE;
  if (stack.empty() || found->second.context != stack.back()) return CUDA_ERROR_INVALID_CONTEXT;
  memory.erase(found);
  return CUDA_SUCCESS;
}
void* pointer(CUdeviceptr address) {
  return reinterpret_cast<void*>(address);
}
CUresult copy(void* to, const void* from, std::size_t bytes, CUstream stream) {
  if (!fake::is_memory(to, bytes) || !fake::is_memory(from, bytes)) return CUDA_ERROR_INVALID_VALUE;
  return fake::enqueue(stream, [=] { std::memcpy(to, from, bytes); }) ? CUDA_SUCCESS
                                                                      : CUDA_ERROR_INVALID_CONTEXT;
}

}  // namespace

namespace fake {

Alive alive() {
  const std::lock_guard lock(gpu);
  int streams = 0;
  for (const auto& context : contexts) streams += static_cast<int>(context->streams.size());
  return {static_cast<int>(contexts.size()), streams, graphs, static_cast<int>(memory.size())};
}
CUcontext current() {
  return stack.empty() ? nullptr : stack.back();
}
bool enqueue(CUstream stream, std::function<void()> block, int blocks) {
  const std::lock_guard lock(gpu);
  return queue(stream, {std::move(block), blocks});
}
Busy last_busy(CUstream stream) {
  const std::lock_guard lock(gpu);
  return stream->busy;
}
Device::Device(int count) {
  {
    const std::lock_guard lock(gpu);
    units = count;
  }
  for (int i = 0; i < count; ++i) units_.emplace_back(run_unit);
}
Device::~Device() {
  {
    const std::lock_guard lock(gpu);
    units = 0;
    changed.notify_all();
  }
  for (std::thread& unit : units_) unit.join();
}
void set_priorities(int count) {
  const std::lock_guard lock(gpu);
  priorities = count;
}
std::size_t queued() {
  const std::lock_guard lock(gpu);
  std::size_t blocks = 0;
  for (const auto& context : contexts)
    for (const auto& stream : context->streams)
      for (const Kernel& kernel : stream->kernels) blocks += static_cast<std::size_t>(kernel.left);
  return blocks;
}
int priority_of(CUstream stream) {
  const std::lock_guard lock(gpu);
  return -stream->priority;
}
bool is_memory(const void* address, std::size_t bytes) {
  const std::lock_guard lock(gpu);
  const auto* at = static_cast<const std::byte*>(address);
  for (const auto& [begin, block] : memory) {
    const auto* from = static_cast<const std::byte*>(begin);
    if (at >= from && at + bytes <= from + block.bytes.size())
      return !stack.empty() && block.context == stack.back();
  }
  return false;
}
void fail_allocation(int number) {
  const std::lock_guard lock(gpu);
  failing = number;
}

}  // namespace fake

extern "C" {
CUresult cuCtxPushCurrent_v2(CUcontext context);
CUresult cuCtxPopCurrent_v2(CUcontext* context);
CUresult cuDevicePrimaryCtxRelease_v2(CUdevice device);
CUresult cuInit(unsigned flags) {
  return flags == 0 ? CUDA_SUCCESS : CUDA_ERROR_INVALID_VALUE;
}
CUresult cuGetErrorString(CUresult error, const char** text) {
  *text = error == CUDA_ERROR_INVALID_DEVICE  ? "invalid device ordinal"
          : error == CUDA_ERROR_OUT_OF_MEMORY ? "out of memory"
                                              : "another error";
  return CUDA_SUCCESS;
}
CUresult cuDeviceGet(CUdevice* device, int ordinal) {
  *device = ordinal;
  return ordinal == 0 ? CUDA_SUCCESS : CUDA_ERROR_INVALID_DEVICE;
}
CUresult cuCtxCreate(CUcontext* context, unsigned, CUdevice) {
  const std::lock_guard lock(gpu);
  contexts.push_back(std::make_unique<CUctx_st>());
  *context = contexts.back().get();
  stack.push_back(*context);
  return CUDA_SUCCESS;
}
CUresult cuCtxDestroy(CUcontext context) {
  const std::lock_guard lock(gpu);
  if (find(context) == nullptr || context->primary) return CUDA_ERROR_INVALID_CONTEXT;
  std::erase_if(contexts, [&](const auto& one) { return one.get() == context; });
  return CUDA_SUCCESS;
}
CUresult cuDevicePrimaryCtxRetain(CUcontext* context, CUdevice device) {
  const std::lock_guard lock(gpu);
  if (device != 0) return CUDA_ERROR_INVALID_DEVICE;
  auto primary =
      std::find_if(contexts.begin(), contexts.end(), [](const auto& one) { return one->primary; });
  if (primary == contexts.end()) {
    contexts.push_back(std::make_unique<CUctx_st>(CUctx_st{true}));
    primary = std::prev(contexts.end());
  }
  ++(*primary)->users;
  *context = primary->get();
  return CUDA_SUCCESS;
}
CUresult cuDevicePrimaryCtxRelease(CUdevice) {
  const std::lock_guard lock(gpu);
  const auto primary =
      std::find_if(contexts.begin(), contexts.end(), [](const auto& one) { return one->primary; });
  if (primary == contexts.end()) return CUDA_ERROR_INVALID_CONTEXT;
  if (--(*primary)->users == 0) contexts.erase(primary);
  return CUDA_SUCCESS;
}
CUresult cuCtxPushCurrent(CUcontext context) {
  stack.push_back(context);
  return CUDA_SUCCESS;
}
CUresult cuCtxPopCurrent(CUcontext* context) {
  if (stack.empty()) return CUDA_ERROR_INVALID_CONTEXT;
  *context = stack.back();
  stack.pop_back();
  return CUDA_SUCCESS;
}
CUresult cuCtxGetStreamPriorityRange(int* least, int* greatest) {
  const std::lock_guard lock(gpu);
  if (stack.empty()) return CUDA_ERROR_INVALID_CONTEXT;
  *least = 0;
  *greatest = 1 - priorities;
  return CUDA_SUCCESS;
}
CUresult cuStreamCreate(CUstream* stream, unsigned flags) {
  return create(stream, flags, 0);
}
CUresult cuStreamCreateWithPriority(CUstream* stream, unsigned flags, int priority) {
  return create(stream, flags, std::clamp(priority, 1 - priorities, 0));  // as the guide says
}
CUresult cuStreamDestroy(CUstream stream) {
  const std::lock_guard lock(gpu);
  if (find(stream) == nullptr) return CUDA_ERROR_INVALID_VALUE;
  std::erase_if(stream->context->streams, [&](const auto& one) { return one.get() == stream; });
  return CUDA_SUCCESS;
}
CUresult cuStreamSynchronize(CUstream stream) {
  std::unique_lock lock(gpu);
  if (find(stream) == nullptr) return CUDA_ERROR_INVALID_VALUE;
  if (stream->capturing) return CUDA_ERROR_STREAM_CAPTURE_UNSUPPORTED;
  while (!stream->kernels.empty()) {
    CUstream_st* next = units > 0 || busy > 0 ? nullptr : next_of(*stream->context);
    if (next == nullptr)
      changed.wait(lock);
    else
      run_next(*next, lock);
  }
  return CUDA_SUCCESS;
}
CUresult cuStreamBeginCapture(CUstream stream, CUstreamCaptureMode) {
  const std::lock_guard lock(gpu);
  if (stream->capturing || !stream->kernels.empty()) return CUDA_ERROR_STREAM_CAPTURE_UNSUPPORTED;
  stream->capturing = true;
  return CUDA_SUCCESS;
}
CUresult cuStreamEndCapture(CUstream stream, CUgraph* graph) {
  const std::lock_guard lock(gpu);
  if (!stream->capturing) return CUDA_ERROR_INVALID_VALUE;
  stream->capturing = false;
  *graph = new CUgraph_st{{stream->kernels.begin(), stream->kernels.end()}};
  ++graphs;
  stream->kernels.clear();
  return CUDA_SUCCESS;
}
CUresult cuGraphInstantiateWithFlags(CUgraphExec* made, CUgraph graph, unsigned long long) {
  const std::lock_guard lock(gpu);
  *made = new CUgraphExec_st{stack.back(), graph->kernels};
  ++graphs;
  return CUDA_SUCCESS;
}
CUresult cuGraphLaunch(CUgraphExec graph, CUstream stream) {
  const std::lock_guard lock(gpu);
  for (const Kernel& kernel : graph->kernels)
    if (!queue(stream, kernel)) return CUDA_ERROR_INVALID_CONTEXT;
  return CUDA_SUCCESS;
}
CUresult cuGraphDestroy(CUgraph graph) {
  const std::lock_guard lock(gpu);
  delete graph;
  --graphs;
  return CUDA_SUCCESS;
}
CUresult cuGraphExecDestroy(CUgraphExec graph) {
  const std::lock_guard lock(gpu);
  if (stack.empty() || stack.back() != graph->context) return CUDA_ERROR_INVALID_CONTEXT;
  delete graph;
  --graphs;
  return CUDA_SUCCESS;
}
CUresult cuMemAlloc(CUdeviceptr* made, std::size_t bytes) {
  void* block = nullptr;
  const CUresult result = allocate(&block, bytes, true);
  *made = reinterpret_cast<CUdeviceptr>(block);
  return result;
}
CUresult cuMemFree(CUdeviceptr block) {
  return release(pointer(block));
}
CUresult cuMemHostAlloc(void** made, std::size_t bytes, unsigned flags) {
  {
    const std::lock_guard lock(gpu);
    if (failing >= 0 && failing-- == 0) return CUDA_ERROR_OUT_OF_MEMORY;
  }
  return allocate(made, bytes, (flags & CU_MEMHOSTALLOC_DEVICEMAP) != 0);
}
CUresult cuMemHostGetDevicePointer(CUdeviceptr* device, void* host, unsigned) {
  const std::lock_guard lock(gpu);
  const auto found = memory.find(host);
  if (found == memory.end() || !found->second.mapped) return CUDA_ERROR_INVALID_VALUE;
  *device = reinterpret_cast<CUdeviceptr>(host);
  return CUDA_SUCCESS;
}
CUresult cuMemFreeHost(void* block) {
  return release(block);
}
CUresult cuMemcpyHtoDAsync(CUdeviceptr to, const void* from, std::size_t bytes, CUstream stream) {
  return copy(pointer(to), from, bytes, stream);
}
CUresult cuMemcpyDtoHAsync(void* to, CUdeviceptr from, std::size_t bytes, CUstream stream) {
  return copy(to, pointer(from), bytes, stream);
}

// The kernel of bench/nvidia: each of its waves takes as long as its multiplications on an H100 (stage.h).
CUresult cuModuleLoadData(CUmodule* module, const void*) {
  *module = nullptr;
  return stack.empty() ? CUDA_ERROR_INVALID_CONTEXT : CUDA_SUCCESS;
}
CUresult cuModuleGetFunction(CUfunction* function, CUmodule, const char* name) {
  *function = nullptr;
  return std::strcmp(name, "work") == 0 ? CUDA_SUCCESS : CUDA_ERROR_INVALID_VALUE;
}
CUresult cuFuncSetAttribute(CUfunction, CUfunction_attribute, int) {
  return CUDA_SUCCESS;
}
CUresult cuLaunchKernel(CUfunction, unsigned grid, unsigned, unsigned, unsigned, unsigned, unsigned,
                        unsigned, CUstream stream, void** arguments, void**) {
  constexpr unsigned kWave = 264, kPerUs = 320;
  if (grid == 0 || grid % kWave != 0) return CUDA_ERROR_INVALID_VALUE;
  const std::chrono::microseconds time(*static_cast<unsigned long long*>(arguments[0]) / kPerUs);
  const auto wave = [time] { std::this_thread::sleep_for(time); };
  return fake::enqueue(stream, wave, static_cast<int>(grid / kWave)) ? CUDA_SUCCESS
                                                                     : CUDA_ERROR_INVALID_CONTEXT;
}

// As the library exports them, beside what cuda.h calls them.
CUresult cuCtxPushCurrent_v2(CUcontext context) {
  return cuCtxPushCurrent(context);
}
CUresult cuCtxPopCurrent_v2(CUcontext* context) {
  return cuCtxPopCurrent(context);
}
CUresult cuDevicePrimaryCtxRelease_v2(CUdevice device) {
  return cuDevicePrimaryCtxRelease(device);
}
}
