// SPDX-License-Identifier: Apache-2.0
#include "opencl.h"

#define CL_TARGET_OPENCL_VERSION 120
#include <stdexcept>
#include <string>
#include <vector>

#include <CL/cl.h>

namespace pedestrians {
namespace {

constexpr const char* kSource = R"cl(
__kernel void grey_full(__global const uchar* bgr, __global uchar* out) {
  const size_t i = get_global_id(0);
  out[i] = (uchar)((77 * bgr[3 * i + 2] + 150 * bgr[3 * i + 1] + 29 * bgr[3 * i] + 128) >> 8);
}
__kernel void grey_half(__global const uchar* full, __global uchar* out, const int full_width) {
  const int x = get_global_id(0), y = get_global_id(1), width = get_global_size(0);
  __global const uchar* a = full + 2 * y * full_width + 2 * x;
  __global const uchar* b = a + full_width;
  out[y * width + x] = (uchar)((a[0] + a[1] + b[0] + b[1] + 2) >> 2);
}
__kernel void majority(__global const uchar* mask, __global uchar* out) {
  const int x = get_global_id(0), y = get_global_id(1);
  const int width = get_global_size(0), height = get_global_size(1);
  int set = 0;
  for (int dy = -1; dy <= 1; ++dy)
    for (int dx = -1; dx <= 1; ++dx) {
      const int xx = x + dx, yy = y + dy;
      if (xx >= 0 && xx < width && yy >= 0 && yy < height) set += mask[yy * width + xx] != 0;
    }
  out[y * width + x] = set >= 5 ? 255 : 0;
}
)cl";

void check(cl_int error, const char* call) {
  if (error != CL_SUCCESS)
    throw std::runtime_error(std::string(call) + ": OpenCL error " + std::to_string(error));
}

template <class Handle, cl_int (*kRelease)(Handle)>
class Owned {
 public:
  Owned() = default;
  explicit Owned(Handle handle) : handle_(handle) {}
  Owned(Owned&& other) noexcept : handle_(std::exchange(other.handle_, nullptr)) {}
  Owned& operator=(Owned&& other) noexcept {
    std::swap(handle_, other.handle_);
    return *this;
  }
  ~Owned() {
    if (handle_ != nullptr) kRelease(handle_);
  }
  [[nodiscard]] Handle get() const { return handle_; }

 private:
  Handle handle_ = nullptr;
};
using Context = Owned<cl_context, clReleaseContext>;
using Queue = Owned<cl_command_queue, clReleaseCommandQueue>;
using Program = Owned<cl_program, clReleaseProgram>;
using Kernel = Owned<cl_kernel, clReleaseKernel>;
using Buffer = Owned<cl_mem, clReleaseMemObject>;

}  // namespace

struct OpenCl::Device {
  cl_device_id id = nullptr;
  Context context;
  Queue queue;
  Program program;
  Kernel grey_full, grey_half, majority;
  struct Sized {
    Buffer buffer;
    std::size_t bytes = 0;
  };
  Sized bgr, full, half, mask, clean;  ///< kept from frame to frame

  cl_mem sized(Sized& sized, std::size_t bytes) {
    if (sized.bytes != bytes) {
      cl_int error = CL_SUCCESS;
      sized.buffer =
          Buffer(clCreateBuffer(context.get(), CL_MEM_READ_WRITE, bytes, nullptr, &error));
      check(error, "clCreateBuffer");
      sized.bytes = bytes;
    }
    return sized.buffer.get();
  }
  void write(cl_mem to, const cv::Mat& from) {
    check(clEnqueueWriteBuffer(queue.get(), to, CL_TRUE, 0, from.total() * from.elemSize(),
                               from.data, 0, nullptr, nullptr),
          "clEnqueueWriteBuffer");
  }
  void read(cl_mem from, cv::Mat& to) {
    check(clEnqueueReadBuffer(queue.get(), from, CL_TRUE, 0, to.total(), to.data, 0, nullptr,
                              nullptr),
          "clEnqueueReadBuffer");
  }
  template <class T>
  static void argument(const Kernel& kernel, cl_uint index, const T& value) {
    check(clSetKernelArg(kernel.get(), index, sizeof value, &value), "clSetKernelArg");
  }
  void run(const Kernel& kernel, std::size_t width, std::size_t height) {
    const std::size_t size[] = {width, height};
    check(clEnqueueNDRangeKernel(queue.get(), kernel.get(), height == 1 ? 1 : 2, nullptr, size,
                                 nullptr, 0, nullptr, nullptr),
          "clEnqueueNDRangeKernel");
  }
};

OpenCl::OpenCl() : device_(std::make_unique<Device>()) {
  Device& d = *device_;
  cl_platform_id platform = nullptr;
  cl_uint platforms = 0;
  if (clGetPlatformIDs(1, &platform, &platforms) != CL_SUCCESS || platforms == 0)
    throw std::runtime_error(
        "no OpenCL driver: `apt-get install pocl-opencl-icd` runs OpenCL on the CPU");
  check(clGetDeviceIDs(platform, CL_DEVICE_TYPE_ALL, 1, &d.id, nullptr), "clGetDeviceIDs");
  cl_int error = CL_SUCCESS;
  d.context = Context(clCreateContext(nullptr, 1, &d.id, nullptr, nullptr, &error));
  check(error, "clCreateContext");
  d.queue = Queue(clCreateCommandQueue(d.context.get(), d.id, 0, &error));
  check(error, "clCreateCommandQueue");
  const char* source = kSource;
  d.program = Program(clCreateProgramWithSource(d.context.get(), 1, &source, nullptr, &error));
  check(error, "clCreateProgramWithSource");
  if (clBuildProgram(d.program.get(), 1, &d.id, "", nullptr, nullptr) != CL_SUCCESS) {
    std::vector<char> log(16384, 0);
    clGetProgramBuildInfo(d.program.get(), d.id, CL_PROGRAM_BUILD_LOG, log.size() - 1, log.data(),
                          nullptr);
    throw std::runtime_error(std::string("the OpenCL kernels do not build: ") + log.data());
  }
  const auto kernel = [&](const char* name) {
    Kernel made(clCreateKernel(d.program.get(), name, &error));
    check(error, name);
    return made;
  };
  d.grey_full = kernel("grey_full");
  d.grey_half = kernel("grey_half");
  d.majority = kernel("majority");
}

OpenCl::~OpenCl() = default;

void OpenCl::to_grey(const cv::Mat& bgr, Grey& grey) {
  Device& d = *device_;
  CV_Assert(bgr.isContinuous() && bgr.type() == CV_8UC3);
  grey.full.create(bgr.size(), CV_8UC1);
  grey.half.create(bgr.rows / 2, bgr.cols / 2, CV_8UC1);
  const cl_mem in = d.sized(d.bgr, bgr.total() * 3), full = d.sized(d.full, grey.full.total()),
               half = d.sized(d.half, grey.half.total());
  d.write(in, bgr);
  Device::argument(d.grey_full, 0, in);
  Device::argument(d.grey_full, 1, full);
  d.run(d.grey_full, grey.full.total(), 1);
  Device::argument(d.grey_half, 0, full);
  Device::argument(d.grey_half, 1, half);
  Device::argument(d.grey_half, 2, static_cast<cl_int>(bgr.cols));
  d.run(d.grey_half, static_cast<std::size_t>(grey.half.cols),
        static_cast<std::size_t>(grey.half.rows));
  d.read(full, grey.full);
  d.read(half, grey.half);
}

void OpenCl::clean_mask(const cv::Mat& mask, cv::Mat& clean) {
  Device& d = *device_;
  CV_Assert(mask.isContinuous() && mask.type() == CV_8UC1);
  clean.create(mask.size(), CV_8UC1);
  const cl_mem in = d.sized(d.mask, mask.total()), out = d.sized(d.clean, mask.total());
  d.write(in, mask);
  Device::argument(d.majority, 0, in);
  Device::argument(d.majority, 1, out);
  d.run(d.majority, static_cast<std::size_t>(mask.cols), static_cast<std::size_t>(mask.rows));
  d.read(out, clean);
}

}  // namespace pedestrians
