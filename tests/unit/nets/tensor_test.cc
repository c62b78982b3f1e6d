// SPDX-License-Identifier: Apache-2.0
// What an app counts on, beside what a model has.
#include <gtest/gtest.h>

#include <xauto/tensor.h>

namespace {

using xauto::ElementType;
using xauto::kAnyDimension;
using xauto::tensor;
using xauto::TensorSpec;
using xauto::detail::agreed;

TEST(Tensor, TypesOfCppHaveElementTypesOfTheirSize) {
  EXPECT_EQ(xauto::element_type<float>(), ElementType::kFloat32);
  EXPECT_EQ(xauto::element_type<char>(),
            std::is_signed_v<char> ? ElementType::kInt8 : ElementType::kUint8);
  EXPECT_EQ(xauto::element_type<long long>(), ElementType::kInt64);
  EXPECT_EQ(xauto::size_of(xauto::element_type<xauto::Half>()), sizeof(xauto::Half));
  EXPECT_EQ(xauto::size_of(ElementType::kUint16), 2U);
  EXPECT_EQ(xauto::size_of(ElementType::kBool), 1U);
  EXPECT_STREQ(xauto::name_of(ElementType::kFloat32), "float32");
  EXPECT_STREQ(xauto::name_of(ElementType::kBool), "bool");
}

TEST(Tensor, EachSideFillsInWhatTheOtherLeavesOpen) {
  const auto both =
      agreed(tensor<float>("x", {kAnyDimension, 3, 8}), tensor<float>("x", {2, 3, -1}), "net");
  ASSERT_TRUE(both);
  EXPECT_EQ(*both, tensor<float>("x", {2, 3, 8}));
  const auto open = agreed(tensor<float>("x", {kAnyDimension}), tensor<float>("x", {-1}), "net");
  ASSERT_TRUE(open);
  EXPECT_FALSE(xauto::detail::is_known(open->shape));
}

TEST(Tensor, WhatDiffersIsRefused) {
  const TensorSpec has = tensor<float>("x", {2, -1});
  for (const TensorSpec& asked :
       {tensor<int>("x", {2, 4}), tensor<float>("x", {3, 4}), tensor<float>("x", {2}),
        tensor<float>("x", {2, 0}), tensor<float>("x", {2, -5}), tensor<float>("x", {-5, 4})})
    EXPECT_FALSE(agreed(asked, has, "net")) << xauto::detail::text_of(asked);
}

TEST(Tensor, SizesAreBounded) {
  EXPECT_EQ(*xauto::detail::bytes_of(tensor<double>("x", {3, 5}), "net"), 120U);
  EXPECT_EQ(*xauto::detail::bytes_of(tensor<double>("x", {}), "net"), 8U);
  EXPECT_EQ(*xauto::detail::bytes_of(tensor<double>("x", {1LL << 40, 0}), "net"), 0U);
  EXPECT_FALSE(xauto::detail::bytes_of(tensor<std::uint8_t>("x", {(1LL << 31) + 1}), "net"));
  EXPECT_FALSE(xauto::detail::bytes_of(tensor<float>("x", {1LL << 62, 1LL << 62, 16}), "net"));
}

}  // namespace
