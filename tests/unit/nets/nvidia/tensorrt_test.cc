// SPDX-License-Identifier: Apache-2.0
// xauto/tensorrt.h against a TensorRT that is acted out (tests/nvidia/): whether it calls what the documentation
// asks for, in that order, in its context, and gives everything back. What NVIDIA's own does, this cannot show.
#include <cstring>
#include <filesystem>
#include <fstream>
#include <map>
#include <new>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <unistd.h>

#include <xauto/tensorrt.h>
#include <xauto/testing.h>

#include "xpu/callbacks.h"

#include "fake.h"

namespace {

using xauto::ErrorCode;
using xauto::tensor;
using xauto::tensorrt::Session;
namespace nv = nvinfer1;

int objects = 0;           ///< of the acted-out TensorRT, alive
int priority_of_last = 0;  ///< of the stream that it queued on last

/// What the "plan" is: a net of y = 2 x + 1 and n = the number of the run. Tests change it.
struct Plan {
  nv::DataType type = nv::DataType::kFLOAT;
  nv::TensorFormat format = nv::TensorFormat::kLINEAR;
  nv::TensorLocation location = nv::TensorLocation::kDEVICE;
  bool data_dependent = false;
  bool fails = false;
};
Plan plan;

struct Counted {
  Counted() { ++objects; }
  ~Counted() {
    --objects;
    EXPECT_NE(fake::current(), nullptr) << "destroyed outside of its context";
  }
};

class Execution final : public nv::IExecutionContext, Counted {
 public:
  explicit Execution(nv::ILogger& logger) : logger_(logger) {}
  bool setInputShape(const char* name, const nv::Dims& dims) noexcept override {
    if (std::string(name) != "x" || dims.nbDims != 2 || dims.d[0] < 1 || dims.d[0] > 8 ||
        dims.d[1] != 3)
      return false;
    rows_ = dims.d[0];
    return true;
  }
  nv::Dims getTensorShape(const char* name) const noexcept override {
    if (std::string(name) == "n") return {1, {1}};
    return {2, {plan.data_dependent ? -1 : rows_, 3}};
  }
  bool setTensorAddress(const char* name, void* data) noexcept override {
    address_[name] = static_cast<float*>(data);
    return true;
  }
  bool enqueueV3(cudaStream_t stream) noexcept override {
    priority_of_last = fake::priority_of(stream);
    const auto count = static_cast<std::size_t>(rows_ * 3);
    float *x = address_["x"], *y = address_["y"], *n = address_["n"];
    if (plan.fails || !fake::is_memory(x, count * 4) || !fake::is_memory(y, count * 4) ||
        !fake::is_memory(n, 4)) {
      logger_.log(nv::ILogger::Severity::kWARNING, "nothing");
      logger_.log(nv::ILogger::Severity::kERROR, "enqueue went wrong");
      return false;
    }
    return fake::enqueue(stream, [=, this] {
      for (std::size_t i = 0; i < count; ++i) y[i] = 2 * x[i] + 1;
      *n = static_cast<float>(++runs_);
    });
  }

 private:
  nv::ILogger& logger_;
  std::int64_t rows_ = -1;
  int runs_ = 0;
  std::map<std::string, float*> address_;
};

class Engine final : public nv::ICudaEngine, Counted {
 public:
  explicit Engine(nv::ILogger& logger) : logger_(logger) {}
  std::int32_t getNbIOTensors() const noexcept override { return 3; }
  const char* getIOTensorName(std::int32_t index) const noexcept override {
    constexpr const char* kNames[] = {"n", "x", "y"};
    return kNames[index];
  }
  nv::TensorIOMode getTensorIOMode(const char* name) const noexcept override {
    return *name == 'x' ? nv::TensorIOMode::kINPUT : nv::TensorIOMode::kOUTPUT;
  }
  nv::DataType getTensorDataType(const char*) const noexcept override { return plan.type; }
  nv::Dims getTensorShape(const char* name) const noexcept override {
    if (*name == 'n') return {1, {1}};
    return {2, {-1, 3}};
  }
  nv::TensorLocation getTensorLocation(const char*) const noexcept override {
    return plan.location;
  }
  nv::TensorFormat getTensorFormat(const char*) const noexcept override { return plan.format; }
  nv::IExecutionContext* createExecutionContext() noexcept override {
    return new (std::nothrow) Execution(logger_);
  }

 private:
  nv::ILogger& logger_;
};

class Runtime final : public nv::IRuntime, Counted {
 public:
  explicit Runtime(nv::ILogger& logger) : logger_(logger) {}
  nv::ICudaEngine* deserializeCudaEngine(const void* blob, std::size_t size) noexcept override {
    if (std::string(static_cast<const char*>(blob), size) == "a plan")
      return new (std::nothrow) Engine(logger_);
    logger_.log(nv::ILogger::Severity::kERROR, "of another version");
    return nullptr;
  }

 private:
  nv::ILogger& logger_;
};

class TensorRt : public testing::Test {
 protected:
  void SetUp() override {
    std::string pattern = (std::filesystem::temp_directory_path() / "xauto-plan-XXXXXX").string();
    const int descriptor = mkstemp(pattern.data());
    ASSERT_GE(descriptor, 0);
    close(descriptor);
    file_ = pattern;
    write("a plan");
    plan = {};
  }
  void TearDown() override {
    EXPECT_EQ(fake::alive().contexts, 0);
    EXPECT_EQ(fake::alive().memory, 0);
    EXPECT_EQ(objects, 0);
    EXPECT_EQ(fake::current(), nullptr);
    std::filesystem::remove(file_);
  }
  void write(const std::string& bytes) const {
    std::ofstream(file_, std::ios::binary | std::ios::trunc) << bytes;
  }
  xauto::tensorrt::Model model(std::int64_t rows) const {
    return {.file = file_, .inputs = {tensor<float>("x", {rows, 3})}};
  }
  xauto::Error refused(xauto::tensorrt::Model model) const {
    const auto session = Session::open(std::move(model));
    EXPECT_FALSE(session);
    return session ? xauto::Error{} : session.error();
  }
  std::string file_;
};

TEST_F(TensorRt, ComputesFromWhatIsWritten) {
  auto session = Session::open(model(2));
  ASSERT_TRUE(session) << session.error().to_string();
  Session& net = **session;
  EXPECT_EQ(net.outputs()[1], tensor<float>("y", {2, 3}));
  EXPECT_EQ(net.output<float>(0)[0], 1);  // it has run once
  EXPECT_EQ(net.output<float>(1)[5], 1);  // ... on zeros
  for (const float first : {3.0F, 30.0F}) {
    const auto x = net.input<float>(0);
    for (std::size_t i = 0; i < 6; ++i) x[i] = first + static_cast<float>(i);
    ASSERT_TRUE(net.run());
    for (std::size_t i = 0; i < 6; ++i)
      EXPECT_EQ(net.output<float>(1)[i], 2 * (first + static_cast<float>(i)) + 1);
  }
  EXPECT_EQ(net.handle().kind(), xauto::SchedHandle::Kind::kCudaContext);
  EXPECT_NE(net.handle().value(), 0U);
}

TEST_F(TensorRt, ByLevelsPlansShareAContextAndRunOnTheStreamOfTheirJob) {
  {
    auto one = Session::open(model(1), 0, 3), two = Session::open(model(1), 0, 3);
    ASSERT_TRUE(one && two);
    EXPECT_EQ(fake::alive().contexts, 1);
    EXPECT_EQ(fake::alive().streams, 3);
    for (Session* net : {one->get(), two->get()})
      for (const int level : {2, 0, 1}) {
        ASSERT_TRUE(net->handle().callbacks()->take(level));
        net->input<float>(0)[0] = static_cast<float>(level);
        ASSERT_TRUE(net->run());
        EXPECT_EQ(net->output<float>(1)[0], 2.0F * static_cast<float>(level) + 1);
        EXPECT_EQ(priority_of_last, 3 + level);
      }
  }
  EXPECT_EQ(fake::alive().contexts, 0);
  EXPECT_EQ(fake::alive().memory, 0);
}

TEST_F(TensorRt, OutputsThatNobodyAsksForHaveMemory) {
  auto wanted = model(1);
  wanted.outputs = {tensor<float>("y", {1, 3})};
  const auto session = Session::open(std::move(wanted));
  ASSERT_TRUE(session) << session.error().to_string();
  EXPECT_EQ((*session)->outputs().size(), 1U);
}

TEST_F(TensorRt, WhatDiffersFromTheAppIsSaid) {
  EXPECT_EQ(refused(model(9)).what, "the plan takes no input \"x\" of float32 9x3");
  EXPECT_EQ(refused({.file = file_}).what, "the plan takes no input \"x\" of float32 ?x3");
  EXPECT_EQ(refused({.file = file_, .inputs = {tensor<int>("x", {1, 3})}}).what,
            "\"x\" is float32 ?x3 in the model, and the app counts on int32 1x3");
  auto other = model(2);
  other.outputs = {tensor<float>("y", {3, 3})};
  EXPECT_EQ(refused(std::move(other)).what,
            "\"y\" is float32 2x3 in the model, and the app counts on float32 3x3");
}

TEST_F(TensorRt, WhatCannotBeReadByIndexIsRefused) {
  plan.format = nv::TensorFormat::kHWC8;
  EXPECT_EQ(refused(model(1)).what, "\"n\" is not in linear order");
  plan = {.location = nv::TensorLocation::kHOST};
  EXPECT_EQ(refused(model(1)).what, "\"n\" is a shape, not data");
  plan = {.type = nv::DataType::kBF16};
  EXPECT_EQ(refused(model(1)).what, "\"n\" has elements of TensorRT's type 7");
  plan = {.data_dependent = true};
  EXPECT_EQ(refused(model(1)).what, "the size of \"y\" depends on the data (float32 ?x3)");
}

TEST_F(TensorRt, ElementTypesAreTensorRts) {
  for (const auto& [type, bytes] : std::map<nv::DataType, xauto::ElementType>{
           {nv::DataType::kHALF, xauto::ElementType::kFloat16},
           {nv::DataType::kINT8, xauto::ElementType::kInt8},
           {nv::DataType::kINT32, xauto::ElementType::kInt32},
           {nv::DataType::kBOOL, xauto::ElementType::kBool},
           {nv::DataType::kUINT8, xauto::ElementType::kUint8},
           {nv::DataType::kINT64, xauto::ElementType::kInt64}})
    EXPECT_EQ(*xauto::tensorrt::detail::element_type(type, "x", "file"), bytes);
}

TEST_F(TensorRt, ErrorsAreInTensorRtsAndCudasWords) {
  write("of another version");
  const xauto::Error version = refused(model(1));
  EXPECT_EQ(version.what, "TensorRT: of another version");
  EXPECT_EQ(version.where, file_);
  write("");
  EXPECT_EQ(refused(model(1)).code, ErrorCode::kInvalid);
  EXPECT_EQ(refused({.file = file_ + ".absent"}).code, ErrorCode::kNotFound);
  const auto device = Session::open(model(1), 7);
  ASSERT_FALSE(device);
  EXPECT_EQ(device.error().to_string(), "cuDeviceGet: CUDA error 101: invalid device ordinal");
  write("a plan");
  for (int i = 0; i < 3; ++i) {  // whatever was made before is given back
    fake::fail_allocation(i);
    EXPECT_EQ(refused(model(1)).what, "CUDA error 2: out of memory");
  }
  fake::fail_allocation(-1);
  const auto session = Session::open(model(1));
  ASSERT_TRUE(session);
  plan.fails = true;
  const auto failed = (*session)->run();
  ASSERT_FALSE(failed);
  EXPECT_EQ(failed.error().what, "TensorRT: enqueue went wrong");
}

struct State {
  float answer = 0;
};

TEST_F(TensorRt, AnXNodeIsAFileAndAnExec) {
  const xauto::Topic<float> question("question"), answer("answer");
  xauto::XNode<State> node("net");
  node.add_impl(xauto::XPU::GPU, xauto::tensorrt::load(model(1)),
                [&](Session& net, State& state, const xauto::Input& input) -> xauto::Status {
                  net.input<float>(0)[0] = input.get(question);
                  XAUTO_TRY(net.run());
                  state.answer = net.output<float>(1)[0];
                  return {};
                });
  xauto::XModule<State> module("NET");
  module.add_node(node).add_input_topic(question).add_output_topic(answer, &State::answer);
  xauto::testing::Fire fire(module);
  const auto outcome = fire.put(question, 4.0F).run();
  ASSERT_TRUE(outcome) << outcome.error().to_string();
  EXPECT_EQ(outcome->get(answer), 9);
}

}  // namespace

nvinfer1::IRuntime* nvinfer1::createInferRuntime(ILogger& logger) noexcept {
  return new (std::nothrow) Runtime(logger);
}
