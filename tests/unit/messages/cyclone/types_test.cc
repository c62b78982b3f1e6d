// SPDX-License-Identifier: Apache-2.0
// Our types against Cyclone's own: what the plug-in writes, Cyclone's C types read, field by field,
// and what they write again, the plug-in reads. Cyclone checks what it reads, alignment and bounds
// included. ros_types.idl is typed in from the public descriptions, not made by our generator.
#include <chrono>
#include <cstdint>
#include <cstdlib>
#include <string>
#include <thread>

#include <dds/dds.h>
#include <diagnostic_msgs/msg/diagnostic_array.h>
#include <gtest/gtest.h>
#include <nav_msgs/msg/odometry.h>
#include <sensor_msgs/msg/camera_info.h>
#include <sensor_msgs/msg/image.h>
#include <sensor_msgs/msg/imu.h>
#include <sensor_msgs/msg/point_cloud2.h>
#include <std_msgs/msg/float64_multi_array.h>
#include <std_msgs/msg/string.h>
#include <test_msgs/msg/all_kinds.h>
#include <test_msgs/msg/lane.h>
#include <vision_msgs/msg/detection2_d_array.h>

#include "base/clock.h"
#include "transport/bridge.h"

#include "filled.h"
#include "ros_types.h"

namespace xauto::transport {
namespace {

constexpr int kDomain = 83;

class CycloneTypes : public ::testing::Test {
 protected:
  void SetUp() override {
    setenv("CYCLONEDDS_URI",
           "<CycloneDDS><Domain id=\"any\"><General><Interfaces><NetworkInterface name=\"lo\"/>"
           "</Interfaces><AllowMulticast>false</AllowMulticast></General><Discovery>"
           "<ParticipantIndex>auto</ParticipantIndex><Peers><Peer address=\"localhost\"/></Peers>"
           "</Discovery></Domain></CycloneDDS>",
           1);
    auto opened = open_bridge("cyclonedds", {.domain = kDomain, .largest_bytes = 1 << 20});
    ASSERT_TRUE(opened) << opened.error().to_string();
    bridge_ = std::move(*opened);
    participant_ = dds_create_participant(kDomain, nullptr, nullptr);
    ASSERT_GT(participant_, 0);
  }
  void TearDown() override {
    if (participant_ > 0) dds_delete(participant_);
  }

  /// Message number `seed` to C, `check`ed there, and back.
  template <class T, class C, class Check>
  void there_and_back(const dds_topic_descriptor_t& type, Check check) {
    const auto out = *bridge_->publish(*detail::topic_spec(Topic<T>("out")), {});
    const auto in = *bridge_->subscribe(*detail::topic_spec(Topic<T>("in")), {}, doorbell_);
    dds_qos_t* qos = dds_create_qos();
    dds_qset_reliability(qos, DDS_RELIABILITY_RELIABLE, DDS_SECS(1));
    const dds_entity_t reader = dds_create_reader(
        participant_, dds_create_topic(participant_, &type, "rt/out", nullptr, nullptr), qos,
        nullptr);
    const dds_entity_t writer = dds_create_writer(
        participant_, dds_create_topic(participant_, &type, "rt/in", nullptr, nullptr), qos,
        nullptr);
    dds_delete_qos(qos);
    ASSERT_GT(reader, 0);
    ASSERT_GT(writer, 0);
    for (unsigned seed = 1; seed <= 20; ++seed) {
      const auto sent = std::make_shared<T>(test::filled<T>(seed));
      std::shared_ptr<const void> came;
      for (int tries = 0; came == nullptr; ++tries) {  // until both have found each other
        ASSERT_LT(tries, 4000) << "nothing comes";
        // Again only where nobody may have been there: what comes twice is taken for the next one.
        if (tries % 200 == 0) out->publish({sent, now_ns(), seed});
        std::this_thread::sleep_for(std::chrono::milliseconds(1));
        void* sample[1] = {nullptr};
        dds_sample_info_t info;
        while (dds_take(reader, sample, &info, 1, 1) == 1) {
          if (info.valid_data) {
            const C& c = *static_cast<const C*>(sample[0]);
            check(*sent, c);
            ASSERT_EQ(dds_write(writer, &c), DDS_RETCODE_OK);
          }
          dds_return_loan(reader, sample, 1);
        }
        while (auto envelope = in->take()) came = envelope->message;
        if (came != nullptr && !(*static_cast<const T*>(came.get()) == *sent))
          came = tries > 3000 ? came : nullptr;  // an older one may still be under way
      }
      EXPECT_EQ(*static_cast<const T*>(came.get()), *sent) << seed;
    }
    EXPECT_EQ(in->lost(), 0u);
    EXPECT_EQ(out->unsent(), 0u);
  }

  Doorbell doorbell_;
  std::unique_ptr<Bridge> bridge_;
  dds_entity_t participant_ = 0;
};

#define EQ(ours, theirs) EXPECT_EQ(ours, theirs)
#define BYTES(ours, theirs)                                                                    \
  do {                                                                                         \
    ASSERT_EQ((ours).size(), (theirs)._length);                                                \
    for (std::size_t i = 0; i < (ours).size(); ++i) EXPECT_EQ((ours)[i], (theirs)._buffer[i]); \
  } while (false)

template <class Header>
void header(const std_msgs::msg::Header& m, const Header& c) {
  EXPECT_EQ(m.stamp.sec, c.stamp_.sec_);
  EXPECT_EQ(m.stamp.nanosec, c.stamp_.nanosec_);
  EXPECT_EQ(m.frame_id, c.frame_id_);
}

TEST_F(CycloneTypes, Image) {
  there_and_back<sensor_msgs::msg::Image, sensor_msgs_msg_dds__Image_>(
      sensor_msgs_msg_dds__Image__desc, [](const auto& m, const auto& c) {
        header(m.header, c.header_);
        EQ(m.height, c.height_);
        EQ(m.width, c.width_);
        EQ(m.encoding, c.encoding_);
        EQ(m.is_bigendian, c.is_bigendian_);
        EQ(m.step, c.step_);
        BYTES(m.data, c.data_);
      });
}
TEST_F(CycloneTypes, PointCloud2) {
  there_and_back<sensor_msgs::msg::PointCloud2, sensor_msgs_msg_dds__PointCloud2_>(
      sensor_msgs_msg_dds__PointCloud2__desc, [](const auto& m, const auto& c) {
        header(m.header, c.header_);
        ASSERT_EQ(m.fields.size(), c.fields_._length);
        for (std::size_t i = 0; i < m.fields.size(); ++i) {
          EQ(m.fields[i].name, c.fields_._buffer[i].name_);
          EQ(m.fields[i].offset, c.fields_._buffer[i].offset_);
          EQ(m.fields[i].datatype, c.fields_._buffer[i].datatype_);
          EQ(m.fields[i].count, c.fields_._buffer[i].count_);
        }
        EQ(m.point_step, c.point_step_);
        EQ(m.row_step, c.row_step_);
        EQ(m.is_dense, c.is_dense_);
        BYTES(m.data, c.data_);
      });
}
TEST_F(CycloneTypes, Imu) {
  there_and_back<sensor_msgs::msg::Imu, sensor_msgs_msg_dds__Imu_>(
      sensor_msgs_msg_dds__Imu__desc, [](const auto& m, const auto& c) {
        EQ(m.orientation.w, c.orientation_.w_);
        EQ(m.angular_velocity.x, c.angular_velocity_.x_);
        EQ(m.linear_acceleration.z, c.linear_acceleration_.z_);
        EQ(m.linear_acceleration_covariance[8], c.linear_acceleration_covariance_[8]);
      });
}
TEST_F(CycloneTypes, CameraInfo) {
  there_and_back<sensor_msgs::msg::CameraInfo, sensor_msgs_msg_dds__CameraInfo_>(
      sensor_msgs_msg_dds__CameraInfo__desc, [](const auto& m, const auto& c) {
        EQ(m.distortion_model, c.distortion_model_);
        BYTES(m.d, c.d_);
        EQ(m.k[0], c.k_[0]);
        EQ(m.p[11], c.p_[11]);
        EQ(m.roi.do_rectify, c.roi_.do_rectify_);
      });
}
TEST_F(CycloneTypes, Odometry) {
  there_and_back<nav_msgs::msg::Odometry, nav_msgs_msg_dds__Odometry_>(
      nav_msgs_msg_dds__Odometry__desc, [](const auto& m, const auto& c) {
        EQ(m.child_frame_id, c.child_frame_id_);
        EQ(m.pose.pose.position.y, c.pose_.pose_.position_.y_);
        EQ(m.twist.twist.angular.z, c.twist_.twist_.angular_.z_);
        EQ(m.twist.covariance[35], c.twist_.covariance_[35]);
      });
}
TEST_F(CycloneTypes, Detection2DArray) {
  there_and_back<vision_msgs::msg::Detection2DArray, vision_msgs_msg_dds__Detection2DArray_>(
      vision_msgs_msg_dds__Detection2DArray__desc, [](const auto& m, const auto& c) {
        ASSERT_EQ(m.detections.size(), c.detections_._length);
        for (std::size_t i = 0; i < m.detections.size(); ++i) {
          const auto& ours = m.detections[i];
          const auto& theirs = c.detections_._buffer[i];
          EQ(ours.id, theirs.id_);
          EQ(ours.bbox.center.theta, theirs.bbox_.center_.theta_);
          EQ(ours.bbox.size_y, theirs.bbox_.size_y_);
          ASSERT_EQ(ours.results.size(), theirs.results_._length);
          for (std::size_t r = 0; r < ours.results.size(); ++r) {
            EQ(ours.results[r].hypothesis.class_id,
               theirs.results_._buffer[r].hypothesis_.class_id_);
            EQ(ours.results[r].hypothesis.score, theirs.results_._buffer[r].hypothesis_.score_);
          }
        }
      });
}
TEST_F(CycloneTypes, DiagnosticArray) {
  there_and_back<diagnostic_msgs::msg::DiagnosticArray, diagnostic_msgs_msg_dds__DiagnosticArray_>(
      diagnostic_msgs_msg_dds__DiagnosticArray__desc, [](const auto& m, const auto& c) {
        ASSERT_EQ(m.status.size(), c.status_._length);
        for (std::size_t i = 0; i < m.status.size(); ++i) {
          EQ(m.status[i].level, c.status_._buffer[i].level_);
          EQ(m.status[i].hardware_id, c.status_._buffer[i].hardware_id_);
          EQ(m.status[i].values.size(), c.status_._buffer[i].values_._length);
        }
      });
}
TEST_F(CycloneTypes, StdMsgs) {
  there_and_back<std_msgs::msg::String, std_msgs_msg_dds__String_>(
      std_msgs_msg_dds__String__desc, [](const auto& m, const auto& c) { EQ(m.data, c.data_); });
  there_and_back<std_msgs::msg::Empty, std_msgs_msg_dds__Empty_>(std_msgs_msg_dds__Empty__desc,
                                                                 [](const auto&, const auto&) {});
}
TEST_F(CycloneTypes, Float64MultiArray) {
  there_and_back<std_msgs::msg::Float64MultiArray, std_msgs_msg_dds__Float64MultiArray_>(
      std_msgs_msg_dds__Float64MultiArray__desc, [](const auto& m, const auto& c) {
        EQ(m.layout.dim.size(), c.layout_.dim_._length);
        EQ(m.layout.data_offset, c.layout_.data_offset_);
        BYTES(m.data, c.data_);
      });
}
TEST_F(CycloneTypes, EveryKindOfField) {
  there_and_back<test_msgs::msg::AllKinds, test_msgs_msg_dds__AllKinds_>(
      test_msgs_msg_dds__AllKinds__desc, [](const auto& m, const auto& c) {
        EQ(m.a_bool, c.a_bool_);
        EQ(m.an_int64, c.an_int64_);
        EQ(m.a_uint16, c.a_uint16_);
        EQ(m.an_int8, c.an_int8_);
        EQ(m.a_float64, c.a_float64_);
        EQ(m.a_float32, c.a_float32_);
        EQ(m.an_int16, c.an_int16_);
        EQ(m.a_uint64, c.a_uint64_);
        EQ(m.an_int32, c.an_int32_);
        EQ(m.a_uint32, c.a_uint32_);
        EQ(m.a_string, c.a_string_);
        EQ(m.a_short_string, c.a_short_string_);
        EQ(m.bools[2], c.bools_[2]);
        EQ(m.five[4], c.five_[4]);
        EQ(m.two[1], c.two_[1]);
        EQ(m.strings[1], c.strings_[1]);
        EQ(m.parts[1].second, c.parts_[1].second_);
        BYTES(m.bytes, c.bytes_);
        BYTES(m.many_bools, c.many_bools_);
        BYTES(m.longs, c.longs_);
        BYTES(m.at_most_four, c.at_most_four_);
        BYTES(m.texts, c.texts_);
        EQ(m.many_parts.size(), c.many_parts_._length);
        EQ(m.default_, c.default_);
      });
}
TEST_F(CycloneTypes, TypeOfAnIdlFile) {
  there_and_back<test_msgs::msg::Lane, test_msgs_msg_dds__Lane_>(
      test_msgs_msg_dds__Lane__desc, [](const auto& m, const auto& c) {
        EQ(m.coefficients[2], c.coefficients_[2]);
        EQ(m.width, c.width_);
        EQ(m.sure, c.sure_);
        EQ(m.stamp, c.stamp_);
        EQ(m.kinds[3], c.kinds_[3]);
        BYTES(m.order, c.order_);
      });
}

}  // namespace
}  // namespace xauto::transport
