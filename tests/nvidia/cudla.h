/* SPDX-License-Identifier: Apache-2.0 */
/* Stands in for cuDLA's cudla.h, as cuda.h does for CUDA's. */
#pragma once

#include <cstddef>
#include <cstdint>

constexpr std::uint8_t CUDLA_DATA_TYPE_UNKNOWN = 0;
constexpr std::uint8_t CUDLA_DATA_TYPE_FLOAT = 1;
constexpr std::uint8_t CUDLA_DATA_TYPE_HALF = 2;
constexpr std::uint8_t CUDLA_DATA_TYPE_INT16 = 3;
constexpr std::uint8_t CUDLA_DATA_TYPE_INT8 = 4;
constexpr std::uint8_t CUDLA_DATA_TYPE_UINT8 = 5;
constexpr std::uint8_t CUDLA_DATA_TYPE_UINT16 = 6;

enum cudlaStatus {
  cudlaSuccess = 0,
  cudlaErrorInvalidParam = 1,
  cudlaErrorInvalidAddress = 4,
  cudlaErrorInvalidDevice = 8,
  cudlaErrorInvalidModule = 12,
  cudlaErrorDlaErrEngineTimeout = 0x40000006,
};
enum cudlaMode { CUDLA_CUDA_DLA = 0, CUDLA_STANDALONE = 1 };
enum cudlaModuleAttributeType {
  CUDLA_NUM_INPUT_TENSORS = 0,
  CUDLA_NUM_OUTPUT_TENSORS = 1,
  CUDLA_INPUT_TENSOR_DESCRIPTORS = 2,
  CUDLA_OUTPUT_TENSOR_DESCRIPTORS = 3,
};
using cudlaDevHandle = struct cudlaDevHandle_t*;
using cudlaModule = struct cudlaModule_t*;

struct cudlaModuleTensorDescriptor {
  char name[81];
  std::uint64_t size, n, c, h, w;
  std::uint8_t dataFormat, dataType, dataCategory, pixelFormat, pixelMapping;
  std::uint32_t stride[8];
};
union cudlaModuleAttribute {
  std::uint32_t numInputTensors;
  std::uint32_t numOutputTensors;
  cudlaModuleTensorDescriptor* inputTensorDesc;
  cudlaModuleTensorDescriptor* outputTensorDesc;
};
struct cudlaTask {
  cudlaModule moduleHandle;
  std::uint64_t* const* outputTensor;
  std::uint32_t numOutputTensors;
  std::uint32_t numInputTensors;
  const std::uint64_t* const* inputTensor;
  const void* waitEvents;
  void* signalEvents;
};

extern "C" {
cudlaStatus cudlaCreateDevice(std::uint64_t device, cudlaDevHandle* handle, std::uint32_t flags);
cudlaStatus cudlaDestroyDevice(cudlaDevHandle device);
cudlaStatus cudlaModuleLoadFromMemory(cudlaDevHandle device, const std::uint8_t* bytes,
                                      std::size_t size, cudlaModule* module, std::uint32_t flags);
cudlaStatus cudlaModuleUnload(cudlaModule module, std::uint32_t flags);
cudlaStatus cudlaModuleGetAttributes(cudlaModule module, cudlaModuleAttributeType type,
                                     cudlaModuleAttribute* attribute);
cudlaStatus cudlaMemRegister(cudlaDevHandle device, const std::uint64_t* memory, std::size_t size,
                             std::uint64_t** registered, std::uint32_t flags);
cudlaStatus cudlaMemUnregister(cudlaDevHandle device, const std::uint64_t* registered);
cudlaStatus cudlaSubmitTask(cudlaDevHandle device, const cudlaTask* tasks, std::uint32_t count,
                            void* stream, std::uint32_t flags);
cudlaStatus cudlaGetLastError(cudlaDevHandle device);
}
