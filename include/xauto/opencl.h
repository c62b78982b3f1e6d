// SPDX-License-Identifier: Apache-2.0
// An XNode from OpenCL C source. Only for apps that have OpenCL: its header (CL/cl.h) has to be found, and
// libOpenCL is the app's to link.
#pragma once

#include <array>
#include <cstddef>
#include <memory>
#include <span>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#ifndef CL_TARGET_OPENCL_VERSION
#define CL_TARGET_OPENCL_VERSION 120
#endif
#include <CL/cl.h>

#include <xauto/result.h>
#include <xauto/xnode.h>
#include <xauto/xpu.h>

/// XNodes from OpenCL C: opencl.h.
namespace xauto::opencl {

/// What is built, and for which devices.
struct Program {
  std::string source;        ///< OpenCL C, with all kernels
  std::string options = {};  ///< for its compiler
  cl_device_type devices =
      CL_DEVICE_TYPE_ALL;  ///< which count; they are numbered over all platforms
};

namespace detail {

inline Status checked(cl_int error, const std::string& call) {
  if (error == CL_SUCCESS) return {};
  return fail(error == CL_OUT_OF_RESOURCES || error == CL_OUT_OF_HOST_MEMORY ||
                      error == CL_MEM_OBJECT_ALLOCATION_FAILURE || error == CL_DEVICE_NOT_AVAILABLE
                  ? ErrorCode::kUnavailable
                  : ErrorCode::kInvalid,
              "OpenCL error " + std::to_string(error), call);
}

struct Deleter {
  void operator()(cl_context object) const { clReleaseContext(object); }
  void operator()(cl_command_queue object) const { clReleaseCommandQueue(object); }
  void operator()(cl_program object) const { clReleaseProgram(object); }
  void operator()(cl_kernel object) const { clReleaseKernel(object); }
  void operator()(cl_mem object) const { clReleaseMemObject(object); }
};
template <class T>
using Handle = std::unique_ptr<std::remove_pointer_t<T>, Deleter>;

}  // namespace detail

/// Memory of a device. Empty until Session::write or Session::resize makes it; kept from one exec to
/// the next.
class Buffer {
 public:
  /// Its size now.
  [[nodiscard]] std::size_t bytes() const { return bytes_; }
  /// For what this header has no word for; null while empty.
  [[nodiscard]] cl_mem get() const { return memory_.get(); }

 private:
  friend class Session;
  detail::Handle<cl_mem> memory_;
  std::size_t bytes_ = 0;
};

/// A context, an in-order queue and the kernels of a program, on one device. Threads: one at a time.
class Session {
 public:
  /// `index`: which of the devices, from 0 on. Errors: kNotFound: there are not so many; kInvalid:
  /// the source does not compile, with the compiler's words.
  [[nodiscard]] static Result<std::unique_ptr<Session>> open(const Program& program,
                                                             int index = 0) {
    std::unique_ptr<Session> made(new Session);
    XAUTO_ASSIGN(made->device_, device(program.devices, index));
    cl_int error = CL_SUCCESS;
    made->context_.reset(clCreateContext(nullptr, 1, &made->device_, nullptr, nullptr, &error));
    XAUTO_TRY(detail::checked(error, "clCreateContext"));
    made->queue_.reset(clCreateCommandQueue(made->context_.get(), made->device_, 0, &error));
    XAUTO_TRY(detail::checked(error, "clCreateCommandQueue"));
    XAUTO_TRY(made->build(program));
    return made;
  }
  Session(const Session&) = delete;
  Session& operator=(const Session&) = delete;
  ~Session() {
    if (queue_ != nullptr) clFinish(queue_.get());
  }

  /// Makes `buffer` as large as said; what is in it is lost if that changes its size.
  [[nodiscard]] Status resize(Buffer& buffer, std::size_t bytes) {
    if (buffer.bytes_ == bytes && buffer.memory_ != nullptr) return {};
    cl_int error = CL_SUCCESS;
    detail::Handle<cl_mem> made(
        clCreateBuffer(context_.get(), CL_MEM_READ_WRITE, bytes, nullptr, &error));
    XAUTO_TRY(detail::checked(error, "clCreateBuffer of " + std::to_string(bytes) + " bytes"));
    buffer.memory_ = std::move(made);
    buffer.bytes_ = bytes;
    return {};
  }

  /// Copies to the device; `to` becomes as large as `from`. When it returns, `from` may change.
  template <class T>
  [[nodiscard]] Status write(Buffer& to, std::span<const T> from) {
    static_assert(std::is_trivially_copyable_v<T>, "T is copied byte by byte");
    XAUTO_TRY(resize(to, from.size_bytes()));
    return detail::checked(
        clEnqueueWriteBuffer(queue_.get(), to.get(), CL_TRUE, 0, from.size_bytes(), from.data(), 0,
                             nullptr, nullptr),
        "clEnqueueWriteBuffer");
  }

  /// Waits for the kernels that were run, and copies from the device. Error: kInvalid if `from` is
  /// smaller than `to`.
  template <class T>
  [[nodiscard]] Status read(const Buffer& from, std::span<T> to) {
    static_assert(std::is_trivially_copyable_v<T>, "T is copied byte by byte");
    if (from.bytes() < to.size_bytes())
      return fail(ErrorCode::kInvalid, "the buffer has " + std::to_string(from.bytes()) +
                                           " bytes, and " + std::to_string(to.size_bytes()) +
                                           " are asked for");
    return detail::checked(clEnqueueReadBuffer(queue_.get(), from.get(), CL_TRUE, 0,
                                               to.size_bytes(), to.data(), 0, nullptr, nullptr),
                           "clEnqueueReadBuffer");
  }

  /// Queues a kernel on a grid of one to three dimensions. Arguments: Buffers, and values of the
  /// kernel's own types (cl_int, cl_float). finish() or read() waits for it. Errors: kInvalid: no
  /// such kernel, another number of arguments, or an argument that the kernel refuses.
  template <class... Arguments>
  [[nodiscard]] Status run(const std::string& kernel, std::span<const std::size_t> grid,
                           const Arguments&... arguments) {
    for (const Kernel& known : kernels_) {
      if (known.name != kernel) continue;
      if (known.arguments != sizeof...(arguments))
        return fail(ErrorCode::kInvalid,
                    "it has " + std::to_string(known.arguments) + " arguments, and " +
                        std::to_string(sizeof...(arguments)) + " are given",
                    "kernel " + kernel);
      cl_uint place = 0;
      cl_int error = CL_SUCCESS;
      (void)((error = set(known.handle.get(), place++, arguments), error == CL_SUCCESS) && ...);
      if (error != CL_SUCCESS)
        return detail::checked(error,
                               "kernel " + kernel + ", argument " + std::to_string(place - 1));
      return detail::checked(clEnqueueNDRangeKernel(queue_.get(), known.handle.get(),
                                                    static_cast<cl_uint>(grid.size()), nullptr,
                                                    grid.data(), nullptr, 0, nullptr, nullptr),
                             "kernel " + kernel);
    }
    std::string names;
    for (const Kernel& known : kernels_) names += (names.empty() ? "" : ", ") + known.name;
    return fail(ErrorCode::kInvalid, "the program has no such kernel", "kernel " + kernel,
                "it has " + names);
  }
  /// The same on a grid given as it is: `run("grey", {width, height}, in, out)`.
  template <std::size_t kDimensions, class... Arguments>
  [[nodiscard]] Status run(const std::string& kernel, const std::size_t (&grid)[kDimensions],
                           const Arguments&... arguments) {
    return run(kernel, std::span<const std::size_t>(grid), arguments...);
  }

  /// Waits until all that was queued has ended, as an `exec` has to before it returns.
  [[nodiscard]] Status finish() { return detail::checked(clFinish(queue_.get()), "clFinish"); }

  /// For what this header has no word for.
  [[nodiscard]] cl_context context() const { return context_.get(); }
  /// Likewise.
  [[nodiscard]] cl_command_queue queue() const { return queue_.get(); }
  /// Likewise.
  [[nodiscard]] cl_device_id device() const { return device_; }

 private:
  struct Kernel {
    std::string name;
    std::size_t arguments = 0;
    detail::Handle<cl_kernel> handle;
  };
  Session() = default;

  static Result<cl_device_id> device(cl_device_type type, int index) {
    cl_uint count = 0;  // with a loader and no driver the call fails, and there is none
    if (clGetPlatformIDs(0, nullptr, &count) != CL_SUCCESS) count = 0;
    std::vector<cl_platform_id> platforms(count);
    if (count > 0)
      XAUTO_TRY(
          detail::checked(clGetPlatformIDs(count, platforms.data(), nullptr), "clGetPlatformIDs"));
    std::vector<cl_device_id> all;
    for (cl_platform_id platform : platforms) {
      if (clGetDeviceIDs(platform, type, 0, nullptr, &count) != CL_SUCCESS) continue;  // none
      std::vector<cl_device_id> devices(count);
      XAUTO_TRY(detail::checked(clGetDeviceIDs(platform, type, count, devices.data(), nullptr),
                                "clGetDeviceIDs"));
      all.insert(all.end(), devices.begin(), devices.end());
    }
    if (index < 0 || static_cast<std::size_t>(index) >= all.size())
      return fail(ErrorCode::kNotFound,
                  "there is no OpenCL device " + std::to_string(index) + ": there are " +
                      std::to_string(all.size()),
                  {}, "install a driver; `apt-get install pocl-opencl-icd` brings one for CPUs");
    return all[static_cast<std::size_t>(index)];
  }

  Status build(const Program& program) {
    const char* source = program.source.c_str();
    cl_int error = CL_SUCCESS;
    program_.reset(clCreateProgramWithSource(context_.get(), 1, &source, nullptr, &error));
    XAUTO_TRY(detail::checked(error, "clCreateProgramWithSource"));
    if (clBuildProgram(program_.get(), 1, &device_, program.options.c_str(), nullptr, nullptr) !=
        CL_SUCCESS) {
      std::size_t size = 0;
      clGetProgramBuildInfo(program_.get(), device_, CL_PROGRAM_BUILD_LOG, 0, nullptr, &size);
      std::string log(size, '\0');
      clGetProgramBuildInfo(program_.get(), device_, CL_PROGRAM_BUILD_LOG, size, log.data(),
                            nullptr);
      return fail(ErrorCode::kInvalid,
                  "the OpenCL program does not build: " + std::string(log.c_str()));
    }
    cl_uint count = 0;
    XAUTO_TRY(detail::checked(clCreateKernelsInProgram(program_.get(), 0, nullptr, &count),
                              "clCreateKernelsInProgram"));
    std::vector<cl_kernel> made(count);
    XAUTO_TRY(detail::checked(clCreateKernelsInProgram(program_.get(), count, made.data(), nullptr),
                              "clCreateKernelsInProgram"));
    for (cl_kernel kernel : made) kernels_.push_back({{}, 0, detail::Handle<cl_kernel>(kernel)});
    for (Kernel& kernel : kernels_) {
      std::size_t size = 0;
      XAUTO_TRY(detail::checked(
          clGetKernelInfo(kernel.handle.get(), CL_KERNEL_FUNCTION_NAME, 0, nullptr, &size),
          "clGetKernelInfo"));
      std::string name(size, '\0');
      cl_uint arguments = 0;
      XAUTO_TRY(detail::checked(
          clGetKernelInfo(kernel.handle.get(), CL_KERNEL_FUNCTION_NAME, size, name.data(), nullptr),
          "clGetKernelInfo"));
      XAUTO_TRY(detail::checked(clGetKernelInfo(kernel.handle.get(), CL_KERNEL_NUM_ARGS,
                                                sizeof arguments, &arguments, nullptr),
                                "clGetKernelInfo"));
      kernel.name = name.c_str();  // without the zero at its end
      kernel.arguments = arguments;
    }
    return {};
  }

  template <class T>
  static cl_int set(cl_kernel kernel, cl_uint place, const T& value) {
    if constexpr (std::is_same_v<T, Buffer>) {
      const cl_mem memory = value.get();
      return clSetKernelArg(kernel, place, sizeof(cl_mem), &memory);
    } else {
      static_assert(std::is_trivially_copyable_v<T> && !std::is_pointer_v<T>,
                    "an argument is a Buffer or a value");
      return clSetKernelArg(kernel, place, sizeof value, &value);
    }
  }

  cl_device_id device_ = nullptr;
  detail::Handle<cl_context> context_;
  detail::Handle<cl_command_queue> queue_;
  detail::Handle<cl_program> program_;
  std::vector<Kernel> kernels_;
};

/// The `init` of an XNode that runs kernels; its exec gets the Session. The XPU instance's index is the
/// device's: "opencl0" is the first one. OpenCL cannot suspend what is queued, so the XPU is gated. What
/// open() says becomes the message of the exception that ends the run.
[[nodiscard]] inline auto load(Program program) {
  return [program = std::move(program)](const XpuId& xpu) {
    Result<std::unique_ptr<Session>> session = Session::open(program, xpu.index);
    if (!session) throw std::runtime_error(session.error().to_string());
    return own(std::move(session).value(), SchedHandle::gate());
  };
}

}  // namespace xauto::opencl
