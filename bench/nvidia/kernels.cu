// SPDX-License-Identifier: Apache-2.0
// What suspend.cc and app.cc run on a GPU. As PTX: nvcc -ptx -arch=compute_80 kernels.cu
using Count = unsigned long long;

/// A job of app.cc: so many multiplications in each thread.
extern "C" __global__ void work(Count iterations, float* out) {
  float x = threadIdx.x;
  for (Count i = 0; i < iterations; ++i) x = x * 1.0001f + 0.5f;
  if (x == 12345.678f) *out = x;  // never: or the loop would be nothing
}

// The others run until the host writes `stop`, and count for it: one thread of block 0 writes and reads the
// host's memory, the other blocks hear of the end from the GPU's.
__device__ volatile int g_ends;

__device__ bool ends(volatile Count* counter, volatile int* stop) {
  __shared__ int ends_now;
  if (threadIdx.x == 0) {
    if (blockIdx.x == 0) {
      *counter = *counter + 1;
      if (*stop) g_ends = 1;
    }
    ends_now = g_ends;
  }
  __syncthreads();
  const bool result = ends_now != 0;
  __syncthreads();
  return result;
}

extern "C" __global__ void reset() {
  g_ends = 0;
}

extern "C" __global__ void compute(volatile Count* counter, volatile int* stop, float* buffer) {
  float x = threadIdx.x;
  do {
    for (int i = 0; i < 5000; ++i) x = x * 1.0001f + 0.5f;
  } while (!ends(counter, stop));
  if (x == 12345.678f) *buffer = x;
}

/// Through 256 MiB of the GPU's memory.
extern "C" __global__ void stream(volatile Count* counter, volatile int* stop, float* buffer) {
  const Count all = 1ull << 26, step = 1ull * gridDim.x * blockDim.x;
  Count at = 1ull * blockIdx.x * blockDim.x + threadIdx.x;
  do {
    for (int i = 0; i < 200; ++i) {
      buffer[at] = buffer[at] * 1.0001f + 1.0f;
      at = (at + step) % all;
    }
  } while (!ends(counter, stop));
}

/// Every thread reads the host's memory, and nothing else.
extern "C" __global__ void poll(volatile Count* counter, volatile int* stop, float*) {
  while (!*stop)
    if (threadIdx.x == 0 && blockIdx.x == 0) *counter = *counter + 1;
}
