// SPDX-License-Identifier: Apache-2.0
// The whole public API.
#pragma once

#include <xauto/app.h>
#include <xauto/buffer.h>
#include <xauto/parameter.h>
#include <xauto/result.h>
#include <xauto/run.h>
#include <xauto/source.h>
#include <xauto/topic.h>
#include <xauto/xmodule.h>
#include <xauto/xnode.h>
#include <xauto/xpu.h>
