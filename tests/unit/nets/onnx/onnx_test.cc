// SPDX-License-Identifier: Apache-2.0
// xauto/onnx.h on models that are written here, byte by byte, from ONNX's public onnx.proto: what they
// compute is known without any runtime.
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <limits>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <unistd.h>

#include <xauto/onnx.h>
#include <xauto/testing.h>

// Of LeakSanitizer's, where it is linked.
extern "C" void __lsan_disable() __attribute__((weak));
extern "C" void __lsan_enable() __attribute__((weak));

namespace {

namespace fs = std::filesystem;
using xauto::ErrorCode;
using xauto::kAnyDimension;
using xauto::tensor;
using xauto::onnx::Model;
using xauto::onnx::Session;

// Protocol Buffers' wire format: a key (field number, wire type), then a varint, or a length and bytes.
std::string varint(std::uint64_t value) {
  std::string bytes;
  for (; value >= 0x80; value >>= 7) bytes += static_cast<char>(value | 0x80);
  return bytes + static_cast<char>(value);
}
std::string number(int field, std::uint64_t value) {
  return varint(static_cast<std::uint64_t>(field) << 3) + varint(value);
}
std::string field(int number, const std::string& content) {
  return varint(static_cast<std::uint64_t>(number) << 3 | 2) + varint(content.size()) + content;
}

// TensorProto.DataType
constexpr int kFloat = 1, kUint8 = 2, kInt8 = 3, kUint16 = 4, kInt16 = 5, kInt32 = 6, kInt64 = 7,
              kString = 8, kBool = 9, kFloat16 = 10, kDouble = 11, kUint32 = 12, kUint64 = 13;

/// ValueInfoProto; a dimension of -1 is a name, one that the model leaves open.
std::string value_info(const std::string& name, int type, const std::vector<int>& shape) {
  std::string dimensions;
  for (const int d : shape)
    dimensions += field(1, d < 0 ? field(2, "n") : number(1, static_cast<std::uint64_t>(d)));
  return field(1, name) +
         field(2, field(1, number(1, static_cast<std::uint64_t>(type)) + field(2, dimensions)));
}
std::string node(const std::string& op, const std::vector<std::string>& inputs,
                 const std::vector<std::string>& outputs) {
  std::string text;
  for (const std::string& name : inputs) text += field(1, name);
  for (const std::string& name : outputs) text += field(2, name);
  return text + field(4, op);
}
/// TensorProto: a float without dimensions.
std::string constant(const std::string& name, float value) {
  std::string raw(sizeof value, '\0');
  std::memcpy(raw.data(), &value, sizeof value);
  return number(2, kFloat) + field(8, name) + field(9, raw);
}

struct Graph {
  std::vector<std::string> nodes, constants, inputs, outputs;
  [[nodiscard]] std::string model() const {
    std::string graph = field(2, "test");
    for (const std::string& each : nodes) graph += field(1, each);
    for (const std::string& each : constants) graph += field(5, each);
    for (const std::string& each : inputs) graph += field(11, each);
    for (const std::string& each : outputs) graph += field(12, each);
    return number(1, 8) + field(8, field(1, "") + number(2, 13)) + field(7, graph);
  }
};

/// y = 2 x + 1
Graph line(const std::vector<int>& shape) {
  return {{node("Mul", {"x", "two"}, {"scaled"}), node("Add", {"scaled", "one"}, {"y"})},
          {constant("two", 2), constant("one", 1)},
          {value_info("x", kFloat, shape)},
          {value_info("y", kFloat, shape)}};
}
Graph identity(int type, const std::vector<int>& shape) {
  return {{node("Identity", {"x"}, {"y"})},
          {},
          {value_info("x", type, shape)},
          {value_info("y", type, shape)}};
}

/// ONNX Runtime keeps 14 bytes of its first environment until the process ends. What comes later is ours.
class First final : public testing::Environment {
  void SetUp() override {
    if (__lsan_disable != nullptr) __lsan_disable();
    const OrtApi* api = OrtGetApiBase()->GetApi(ORT_API_VERSION);
    OrtEnv* env = nullptr;
    ASSERT_EQ(api->CreateEnv(ORT_LOGGING_LEVEL_ERROR, "first", &env), nullptr);
    api->ReleaseEnv(env);
    if (__lsan_enable != nullptr) __lsan_enable();
  }
};
const testing::Environment* const kFirst = testing::AddGlobalTestEnvironment(new First);

class Onnx : public testing::Test {
 protected:
  void SetUp() override {
    std::string pattern = (fs::temp_directory_path() / "xauto-onnx-XXXXXX").string();
    ASSERT_NE(mkdtemp(pattern.data()), nullptr);
    folder_ = pattern;
  }
  void TearDown() override { fs::remove_all(folder_); }

  std::string file(const std::string& bytes) const {
    const std::string path = folder_ / "net.onnx";
    std::ofstream(path, std::ios::binary) << bytes;
    return path;
  }
  std::unique_ptr<Session> opened(const std::string& bytes, Model model = {}) const {
    model.file = file(bytes);
    auto session = Session::open(std::move(model));
    if (!session) ADD_FAILURE() << session.error().to_string();
    return session ? std::move(session).value() : nullptr;
  }
  xauto::Error refused(const std::string& bytes, Model model = {}) const {
    model.file = file(bytes);
    auto session = Session::open(std::move(model));
    EXPECT_FALSE(session);
    return session ? xauto::Error{} : session.error();
  }
  fs::path folder_;
};

std::size_t threads() {
  const fs::directory_iterator tasks("/proc/self/task");
  return static_cast<std::size_t>(std::distance(begin(tasks), end(tasks)));
}

TEST_F(Onnx, ComputesWhatTheModelSaysFromWhatIsWritten) {
  const auto net = opened(line({2, 3}).model());
  ASSERT_NE(net, nullptr);
  EXPECT_EQ(net->inputs()[0], tensor<float>("x", {2, 3}));
  EXPECT_EQ(net->outputs()[0], tensor<float>("y", {2, 3}));
  const auto x = net->input<float>(0);
  ASSERT_EQ(x.size(), 6U);
  for (const float first : {0.0F, 100.0F}) {
    for (std::size_t i = 0; i < 6; ++i) x[i] = first + static_cast<float>(i);
    ASSERT_TRUE(net->run());
    const auto y = net->output<float>(0);
    ASSERT_EQ(y.size(), 6U);
    for (std::size_t i = 0; i < 6; ++i) EXPECT_EQ(y[i], 2 * (first + static_cast<float>(i)) + 1);
  }
  EXPECT_EQ(net->output_shape(0), (std::vector<std::int64_t>{2, 3}));
}

TEST_F(Onnx, RunsOnceBeforeTheFirstRelease) {
  const auto net = opened(line({1}).model());
  ASSERT_NE(net, nullptr);
  EXPECT_EQ(net->output<float>(0)[0], 1);  // of an input of zero
}

template <class T>
void passes(const Session& net, const std::vector<T>& expected) {
  const auto y = net.output<T>(0);
  ASSERT_EQ(y.size(), expected.size());
  EXPECT_EQ(std::memcmp(y.data(), expected.data(), sizeof(T) * expected.size()), 0);
}

TEST_F(Onnx, ElementTypesAreOnnxs) {
  const auto check = [this]<class T>(int type, std::vector<T> values) {
    SCOPED_TRACE(type);
    const auto net = opened(identity(type, {2}).model(), {.inputs = {tensor<T>("x", {2})}});
    ASSERT_NE(net, nullptr);
    std::copy(values.begin(), values.end(), net->template input<T>(0).begin());
    ASSERT_TRUE(net->run());
    passes(*net, values);
  };
  const auto limits = [&]<class T>(int type, T) {
    check(type, std::vector<T>{std::numeric_limits<T>::lowest(), std::numeric_limits<T>::max()});
  };
  limits(kFloat, float{});
  limits(kDouble, double{});
  limits(kUint8, std::uint8_t{});
  limits(kInt8, std::int8_t{});
  limits(kUint16, std::uint16_t{});
  limits(kInt16, std::int16_t{});
  limits(kInt32, std::int32_t{});
  limits(kUint32, std::uint32_t{});
  limits(kInt64, std::int64_t{});
  limits(kUint64, std::uint64_t{});
  check(kFloat16, std::vector<xauto::Half>{{0x3C00}, {0xFBFF}});  // 1, the lowest
  const auto net = opened(identity(kBool, {2}).model(), {.inputs = {tensor<bool>("x", {2})}});
  ASSERT_NE(net, nullptr);
  net->input<bool>(0)[1] = true;
  ASSERT_TRUE(net->run());
  EXPECT_FALSE(net->output<bool>(0)[0]);
  EXPECT_TRUE(net->output<bool>(0)[1]);
  EXPECT_NE(refused(identity(kString, {2}).model()).what.find("ONNX's type 8"), std::string::npos);
}

TEST_F(Onnx, OrderIsTheAppsAndUnaskedOutputsAreLeftOut) {
  const Graph two{{node("Add", {"a", "b"}, {"sum"}), node("Sub", {"a", "b"}, {"difference"})},
                  {},
                  {value_info("a", kFloat, {1}), value_info("b", kFloat, {1})},
                  {value_info("sum", kFloat, {1}), value_info("difference", kFloat, {1})}};
  const auto net =
      opened(two.model(), {.inputs = {tensor<float>("b", {1}), tensor<float>("a", {1})},
                           .outputs = {tensor<float>("difference", {1})}});
  ASSERT_NE(net, nullptr);
  net->input<float>(0)[0] = 3;
  net->input<float>(1)[0] = 10;
  ASSERT_TRUE(net->run());
  ASSERT_EQ(net->outputs().size(), 1U);
  EXPECT_EQ(net->output<float>(0)[0], 7);
  EXPECT_NE(refused(two.model(), {.inputs = {tensor<float>("a", {1})}}).what.find("has 2 inputs"),
            std::string::npos);
}

TEST_F(Onnx, WhatDiffersFromTheAppIsSaid) {
  const std::string bytes = line({1, 3}).model();
  const xauto::Error name = refused(bytes, {.inputs = {tensor<float>("image", {1, 3})}});
  EXPECT_EQ(name.code, ErrorCode::kInvalid);
  EXPECT_EQ(name.what, "the model has no input \"image\"");
  EXPECT_EQ(name.hint, "its inputs are \"x\" (float32 1x3)");
  EXPECT_EQ(name.where, (folder_ / "net.onnx").string());
  EXPECT_EQ(refused(bytes, {.inputs = {tensor<float>("x", {3, 1})}}).what,
            "\"x\" is float32 1x3 in the model, and the app counts on float32 3x1");
  EXPECT_EQ(refused(bytes, {.outputs = {tensor<std::uint8_t>("y", {1, 3})}}).what,
            "\"y\" is float32 1x3 in the model, and the app counts on uint8 1x3");
  EXPECT_EQ(refused(bytes, {.inputs = {tensor<float>("x", {1})}}).what,
            "\"x\" is float32 1x3 in the model, and the app counts on float32 1");
  EXPECT_EQ(
      refused(bytes, {.outputs = {tensor<float>("y", {1, 3}), tensor<float>("y", {1, 3})}}).what,
      "output \"y\" is asked for twice");
}

TEST_F(Onnx, OpenDimensionsAreTheAppsToState) {
  const std::string bytes = line({-1, 3}).model();
  EXPECT_EQ(refused(bytes).what, "the model leaves the size of input \"x\" open (float32 ?x3)");
  EXPECT_EQ(refused(bytes, {.inputs = {tensor<float>("x", {0, 3})}}).code, ErrorCode::kInvalid);
  EXPECT_NE(refused(bytes, {.inputs = {tensor<float>("x", {1LL << 40, 3})}}).what.find("2 GiB"),
            std::string::npos);
  const auto net = opened(bytes, {.inputs = {tensor<float>("x", {2, kAnyDimension})}});
  ASSERT_NE(net, nullptr);
  EXPECT_EQ(net->inputs()[0], tensor<float>("x", {2, 3}));
  net->input<float>(0)[5] = 4;
  ASSERT_TRUE(net->run());
  EXPECT_EQ(net->output_shape(0), (std::vector<std::int64_t>{2, 3}));
  EXPECT_EQ(net->output<float>(0)[5], 9);
}

TEST_F(Onnx, SizeOfAnOutputMayDependOnTheRun) {
  const Graph graph{{node("NonZero", {"x"}, {"y"})},
                    {},
                    {value_info("x", kFloat, {4})},
                    {value_info("y", kInt64, {1, -1})}};
  const auto net = opened(graph.model());
  ASSERT_NE(net, nullptr);
  EXPECT_EQ(net->output<std::int64_t>(0).size(), 0U);
  const auto x = net->input<float>(0);
  for (const std::vector<std::int64_t>& places :
       {std::vector<std::int64_t>{1, 3}, {0, 1, 2, 3}, {2}}) {
    std::fill(x.begin(), x.end(), 0.0F);
    for (const std::int64_t place : places) x[static_cast<std::size_t>(place)] = 1;
    ASSERT_TRUE(net->run());
    const auto y = net->output<std::int64_t>(0);
    EXPECT_EQ(std::vector<std::int64_t>(y.begin(), y.end()), places);
    EXPECT_EQ(net->output_shape(0),
              (std::vector<std::int64_t>{1, static_cast<std::int64_t>(places.size())}));
  }
}

TEST_F(Onnx, FilesThatAreNoModelAreRefused) {
  const auto absent = Session::open({.file = folder_ / "absent.onnx"});
  ASSERT_FALSE(absent);
  EXPECT_EQ(absent.error().code, ErrorCode::kNotFound);
  EXPECT_EQ(refused("").code, ErrorCode::kInvalid);
  const std::string whole = line({2, 3}).model();
  for (std::size_t length = 1; length < whole.size(); length += 7)
    EXPECT_EQ(refused(whole.substr(0, length)).code, ErrorCode::kInvalid) << length;
}

TEST_F(Onnx, MistakesOfTheProgramThrow) {
  const auto net = opened(line({1}).model());
  ASSERT_NE(net, nullptr);
  EXPECT_THROW((void)net->input<float>(1), std::logic_error);
  EXPECT_THROW((void)net->input<int>(0), std::logic_error);
  EXPECT_THROW((void)net->output<double>(0), std::logic_error);
  EXPECT_THROW((void)net->output_shape(1), std::logic_error);
}

TEST_F(Onnx, OneThreadIsTheCallers) {
  const std::size_t before = threads();
  const auto net = opened(line({64}).model());
  ASSERT_NE(net, nullptr);
  ASSERT_TRUE(net->run());
  EXPECT_EQ(threads(), before);
  const auto more = opened(line({64}).model(), {.threads = 3});
  ASSERT_NE(more, nullptr);
  EXPECT_EQ(threads(), before + 2);
  for (const int bad : {0, -1, 65})
    EXPECT_EQ(refused(line({1}).model(), {.threads = bad}).what,
              "threads is " + std::to_string(bad) + ", not 1 to 64");
}

TEST_F(Onnx, ConfigureSpeaksToOnnxRuntime) {
  bool called = false;
  const auto net =
      opened(line({1}).model(), {.configure = [&](const OrtApi& api, OrtSessionOptions* options) {
               called = true;
               return api.SetSessionGraphOptimizationLevel(options, ORT_DISABLE_ALL);
             }});
  EXPECT_NE(net, nullptr);
  EXPECT_TRUE(called);
  const xauto::Error error =
      refused(line({1}).model(), {.configure = [](const OrtApi& api, OrtSessionOptions*) {
                return api.CreateStatus(ORT_EP_FAIL, "no such device");
              }});
  EXPECT_EQ(error.code, ErrorCode::kUnavailable);
  EXPECT_EQ(error.what, "ONNX Runtime: no such device");
}

struct State {
  float answer = 0;
};

TEST_F(Onnx, AnXNodeIsAFileAndAnExec) {
  const xauto::Topic<float> question("question"), answer("answer");
  const auto module = [&](const std::string& path) {
    xauto::XNode<State> node("net");
    node.add_impl(xauto::XPU::CPU, xauto::onnx::load({.file = path}),
                  [&](Session& net, State& state, const xauto::Input& input) -> xauto::Status {
                    net.input<float>(0)[0] = input.get(question);
                    XAUTO_TRY(net.run());
                    state.answer = net.output<float>(0)[0];
                    return {};
                  });
    xauto::XModule<State> made("NET");
    made.add_node(node).add_input_topic(question).add_output_topic(answer, &State::answer);
    return made;
  };
  xauto::testing::Fire fire(module(file(line({1}).model())));
  for (const float x : {4.0F, 0.5F}) {
    const auto outcome = fire.put(question, x).run();
    ASSERT_TRUE(outcome) << outcome.error().to_string();
    EXPECT_EQ(outcome->get(answer), 2 * x + 1);
  }
  xauto::testing::Fire broken(module(file("no model")));
  const auto outcome = broken.put(question, 1.0F).run();
  ASSERT_FALSE(outcome);
  EXPECT_NE(outcome.error().to_string().find("net.onnx"), std::string::npos);
}

}  // namespace
