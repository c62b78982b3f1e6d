// SPDX-License-Identifier: Apache-2.0
// xauto/cudla.h against a cuDLA that is acted out (tests/nvidia/), as tensorrt_test.cc does with TensorRT.
#include <cstring>
#include <filesystem>
#include <fstream>
#include <set>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <unistd.h>

#include <xauto/cudla.h>
#include <xauto/testing.h>

#include "fake.h"

struct cudlaDevHandle_t {
  std::set<const std::uint64_t*> registered;
  cudlaStatus last = cudlaSuccess;
};
struct cudlaModule_t {};

namespace {

using xauto::ErrorCode;
using xauto::tensor;
using xauto::dla::Session;

int devices = 0, modules = 0;

/// The "loadable": out = 2 in + 1 on bytes. DLAs pad: three pixels a row, and 32 bytes of it.
struct Loadable {
  cudlaModuleTensorDescriptor in, out;
  bool times_out = false;
};
Loadable loadable;
cudlaModuleTensorDescriptor described(const char* name) {
  cudlaModuleTensorDescriptor made{};
  std::strcpy(made.name, name);
  made.n = made.c = 1;
  made.h = 2;
  made.w = 3;
  made.size = 2 * 32;
  made.dataType = CUDLA_DATA_TYPE_INT8;
  made.stride[0] = 1;
  made.stride[1] = 32;
  return made;
}

class CuDla : public testing::Test {
 protected:
  void SetUp() override {
    std::string pattern =
        (std::filesystem::temp_directory_path() / "xauto-loadable-XXXXXX").string();
    const int descriptor = mkstemp(pattern.data());
    ASSERT_GE(descriptor, 0);
    close(descriptor);
    file_ = pattern;
    std::ofstream(file_) << "a loadable";
    loadable = {described("in"), described("out")};
  }
  void TearDown() override {
    EXPECT_EQ(fake::alive().contexts, 0);
    EXPECT_EQ(fake::alive().memory, 0);
    EXPECT_EQ(devices, 0);
    EXPECT_EQ(modules, 0);
    EXPECT_EQ(fake::current(), nullptr);
    std::filesystem::remove(file_);
  }
  xauto::Error refused(xauto::dla::Model model, int index = 0) const {
    if (model.file.empty()) model.file = file_;
    const auto session = Session::open(std::move(model), index);
    EXPECT_FALSE(session);
    return session ? xauto::Error{} : session.error();
  }
  std::string file_;
};

TEST_F(CuDla, ComputesFromWhatIsWritten) {
  auto session =
      Session::open({.file = file_, .inputs = {tensor<std::int8_t>("in", {1, 1, 2, 3})}});
  ASSERT_TRUE(session) << session.error().to_string();
  Session& net = **session;
  EXPECT_EQ(net.outputs()[0], tensor<std::int8_t>("out", {1, 1, 2, 3}));
  EXPECT_EQ(net.output<std::int8_t>(0)[40], 1);  // of zeros
  const std::size_t row = net.input_layout(0).stride[1];
  for (const std::int8_t first : {std::int8_t{3}, std::int8_t{30}}) {
    net.input<std::int8_t>(0)[row + 2] = first;
    ASSERT_TRUE(net.run());
    EXPECT_EQ(net.output<std::int8_t>(0)[net.output_layout(0).stride[1] + 2], 2 * first + 1);
  }
  EXPECT_EQ(net.input<std::int8_t>(0).size(), 64U);
  EXPECT_EQ(net.handle().kind(), xauto::SchedHandle::Kind::kCudlaDevice);
  EXPECT_NE(net.handle().value(), 0U);
}

TEST_F(CuDla, WhatDiffersFromTheAppIsSaid) {
  EXPECT_EQ(refused({.inputs = {tensor<std::int8_t>("in", {1, 1, 3, 2})}}).what,
            "\"in\" is int8 1x1x2x3 in the model, and the app counts on int8 1x1x3x2");
  EXPECT_EQ(refused({.outputs = {tensor<float>("out", {1, 1, 2, 3})}}).what,
            "\"out\" is int8 1x1x2x3 in the model, and the app counts on float32 1x1x2x3");
  EXPECT_EQ(refused({.outputs = {tensor<float>("score", {1})}}).what,
            "the model has no output \"score\"");
}

TEST_F(CuDla, WhatALoadableCannotMeanIsRefused) {
  loadable.in.size = 5;  // of six bytes
  EXPECT_EQ(refused({}).what, "\"in\" (int8 1x1x2x3) takes 5 bytes");
  loadable.in = described("in");
  loadable.out.dataType = CUDLA_DATA_TYPE_UNKNOWN;
  EXPECT_EQ(refused({}).what, "\"out\" has elements of cuDLA's type 0");
  loadable.out = described("out");
  loadable.out.w = std::uint64_t{1} << 60;
  EXPECT_EQ(refused({}).what, "\"out\" is too large");
  std::ofstream(file_) << "something else";
  EXPECT_EQ(refused({}).what, "cudlaModuleLoadFromMemory: cuDLA error 12");
  EXPECT_EQ(refused({.file = file_ + ".absent"}).code, ErrorCode::kNotFound);
  EXPECT_EQ(refused({}, 5).what, "cudlaCreateDevice: cuDLA error 8");
}

TEST_F(CuDla, FaultsOfTheDlaComeOut) {
  const auto session = Session::open({.file = file_});
  ASSERT_TRUE(session) << session.error().to_string();
  loadable.times_out = true;
  const auto failed = (*session)->run();
  ASSERT_FALSE(failed);
  EXPECT_EQ(failed.error().code, ErrorCode::kUnavailable);
  EXPECT_EQ(failed.error().what, "the DLA: cuDLA error " + std::to_string(0x40000006));
  loadable.times_out = false;
  EXPECT_TRUE((*session)->run());
}

TEST_F(CuDla, WhatWasMadeIsGivenBackWhenMemoryRunsOut) {
  for (int i = 0; i < 2; ++i) {
    fake::fail_allocation(i);
    EXPECT_EQ(refused({}).what, "CUDA error 2: out of memory");
  }
  fake::fail_allocation(-1);
}

}  // namespace

extern "C" {
cudlaStatus cudlaCreateDevice(std::uint64_t device, cudlaDevHandle* handle, std::uint32_t flags) {
  if (device > 1 || fake::current() == nullptr) return cudlaErrorInvalidDevice;
  if (flags != CUDLA_CUDA_DLA) return cudlaErrorInvalidParam;
  *handle = new cudlaDevHandle_t;
  ++devices;
  return cudlaSuccess;
}
cudlaStatus cudlaDestroyDevice(cudlaDevHandle device) {
  EXPECT_TRUE(device->registered.empty());
  EXPECT_EQ(modules, 0) << "a module outlives its device";
  delete device;
  --devices;
  return cudlaSuccess;
}
cudlaStatus cudlaModuleLoadFromMemory(cudlaDevHandle, const std::uint8_t* bytes, std::size_t size,
                                      cudlaModule* module, std::uint32_t) {
  if (std::string(reinterpret_cast<const char*>(bytes), size) != "a loadable")
    return cudlaErrorInvalidModule;
  *module = new cudlaModule_t;
  ++modules;
  return cudlaSuccess;
}
cudlaStatus cudlaModuleUnload(cudlaModule module, std::uint32_t) {
  delete module;
  --modules;
  return cudlaSuccess;
}
cudlaStatus cudlaModuleGetAttributes(cudlaModule, cudlaModuleAttributeType type,
                                     cudlaModuleAttribute* attribute) {
  switch (type) {
    case CUDLA_NUM_INPUT_TENSORS:
      attribute->numInputTensors = 1;
      break;
    case CUDLA_NUM_OUTPUT_TENSORS:
      attribute->numOutputTensors = 1;
      break;
    case CUDLA_INPUT_TENSOR_DESCRIPTORS:
      *attribute->inputTensorDesc = loadable.in;
      break;
    case CUDLA_OUTPUT_TENSOR_DESCRIPTORS:
      *attribute->outputTensorDesc = loadable.out;
      break;
  }
  return cudlaSuccess;
}
cudlaStatus cudlaMemRegister(cudlaDevHandle device, const std::uint64_t* memory, std::size_t size,
                             std::uint64_t** registered, std::uint32_t) {
  if (!fake::is_memory(memory, size)) return cudlaErrorInvalidAddress;
  *registered = const_cast<std::uint64_t*>(memory);
  device->registered.insert(memory);
  return cudlaSuccess;
}
cudlaStatus cudlaMemUnregister(cudlaDevHandle device, const std::uint64_t* registered) {
  return device->registered.erase(registered) == 1 ? cudlaSuccess : cudlaErrorInvalidAddress;
}
cudlaStatus cudlaSubmitTask(cudlaDevHandle device, const cudlaTask* task, std::uint32_t count,
                            void* stream, std::uint32_t) {
  if (count != 1 || task->numInputTensors != 1 || task->numOutputTensors != 1 ||
      !device->registered.contains(task->inputTensor[0]) ||
      !device->registered.contains(task->outputTensor[0]))
    return cudlaErrorInvalidParam;
  const auto* in = reinterpret_cast<const std::int8_t*>(task->inputTensor[0]);
  auto* out = reinterpret_cast<std::int8_t*>(task->outputTensor[0]);
  const bool queued = fake::enqueue(static_cast<CUstream>(stream), [=] {
    device->last = loadable.times_out ? cudlaErrorDlaErrEngineTimeout : cudlaSuccess;
    for (std::size_t i = 0; i < 64; ++i) out[i] = static_cast<std::int8_t>(2 * in[i] + 1);
  });
  return queued ? cudlaSuccess : cudlaErrorInvalidParam;
}
cudlaStatus cudlaGetLastError(cudlaDevHandle device) {
  return std::exchange(device->last, cudlaSuccess);
}
}
