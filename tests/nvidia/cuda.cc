// SPDX-License-Identifier: Apache-2.0
#include "cuda.h"

#include <cstring>
#include <map>
#include <memory>
#include <utility>
#include <vector>

#include "fake.h"

struct CUstream_st {
  std::vector<std::function<void()>> work;
};
struct CUctx_st {
  std::unique_ptr<CUstream_st> stream;
};

namespace {

struct Memory {
  std::vector<std::byte> bytes;
  CUcontext context;
  bool mapped;  ///< for the GPU
};
std::map<const void*, Memory> memory;
int contexts = 0, failing = -1;
std::vector<CUcontext> stack;

CUresult allocate(void** made, std::size_t bytes, bool mapped) {
  if (stack.empty()) return CUDA_ERROR_INVALID_CONTEXT;
  if (bytes == 0) return CUDA_ERROR_INVALID_VALUE;
  Memory block{std::vector<std::byte>(bytes, std::byte{0xAA}), stack.back(), mapped};
  *made = block.bytes.data();
  memory.emplace(*made, std::move(block));
  return CUDA_SUCCESS;
}
CUresult release(const void* block) {
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
  return {contexts, static_cast<int>(memory.size())};
}
CUcontext current() {
  return stack.empty() ? nullptr : stack.back();
}
bool enqueue(CUstream stream, std::function<void()> work) {
  if (stack.empty() || stack.back()->stream.get() != stream) return false;
  stream->work.push_back(std::move(work));
  return true;
}
bool is_memory(const void* address, std::size_t bytes) {
  const auto* at = static_cast<const std::byte*>(address);
  for (const auto& [begin, block] : memory) {
    const auto* from = static_cast<const std::byte*>(begin);
    if (at >= from && at + bytes <= from + block.bytes.size())
      return !stack.empty() && block.context == stack.back();
  }
  return false;
}
void fail_allocation(int number) {
  failing = number;
}

}  // namespace fake

extern "C" {
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
  *context = new CUctx_st;
  ++contexts;
  stack.push_back(*context);
  return CUDA_SUCCESS;
}
CUresult cuCtxDestroy(CUcontext context) {
  delete context;
  --contexts;
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
CUresult cuStreamCreate(CUstream* stream, unsigned) {
  if (stack.empty()) return CUDA_ERROR_INVALID_CONTEXT;
  stack.back()->stream = std::make_unique<CUstream_st>();
  *stream = stack.back()->stream.get();
  return CUDA_SUCCESS;
}
CUresult cuStreamSynchronize(CUstream stream) {
  for (const auto& work : std::exchange(stream->work, {})) work();
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
  if (failing >= 0 && failing-- == 0) return CUDA_ERROR_OUT_OF_MEMORY;
  return allocate(made, bytes, (flags & CU_MEMHOSTALLOC_DEVICEMAP) != 0);
}
CUresult cuMemHostGetDevicePointer(CUdeviceptr* device, void* host, unsigned) {
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
}
