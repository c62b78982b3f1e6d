// SPDX-License-Identifier: Apache-2.0
// A second way from pixels to faces and lines: node check.js ONNX-FOLDER RUN-FOLDER
//
// It reads the frames that a run has left (frame-N.ppm), scales them by code of its own, runs the same nets by
// ONNX Runtime's package for node, decodes their outputs by code of its own, and compares with the run's scenes.json.
// What is close to a threshold may be on either side of it; all else has to be found in both, at the same place.
'use strict';
const fs = require('fs');
const path = require('path');

const [onnx, folder] = process.argv.slice(2);
const ort = require(path.resolve(onnx, 'node_modules/onnxruntime-node'));

const SCORE = 0.02;  // two ways of scaling differ by a level of 255 here and there
const LINE_PIXELS = 5;  // a pixel of the smallest map
const FACE_IOU = 0.85;

/** Binary PPM, as RGB. */
function readPpm(file) {
  const bytes = fs.readFileSync(file);
  const header = /^P6\s(?:#.*\n)*(\d+)\s+(\d+)\s+255\s/.exec(bytes.toString('latin1', 0, 200));
  if (!header) throw new Error(`${file}: no PPM of 8 bits`);
  return {width: +header[1], height: +header[2], data: bytes.subarray(header[0].length)};
}

/** What part of which source pixels a target pixel covers, in one dimension. */
function areas(from, to) {
  return Array.from({length: to}, (_, i) => {
    const begin = i * from / to, end = (i + 1) * from / to, parts = [];
    for (let s = Math.floor(begin); s < Math.min(from, Math.ceil(end)); s++)
      parts.push([s, Math.min(s + 1, end) - Math.max(s, begin)]);
    return parts;
  });
}
/** The two neighbours of a target pixel's middle, in one dimension; at the border one twice. */
function neighbours(from, to, origin) {
  return Array.from({length: to}, (_, i) => {
    const at = Math.min(Math.max((i + 0.5) * from / to - 0.5, 0), from - 1), s = Math.floor(at);
    return [[origin + s, 1 - (at - s)], [origin + Math.min(s + 1, from - 1), at - s]];
  });
}
/** Scaled to size x size; `make` gets a pixel's three values, rounded as those of an image are. */
function scaled(image, columns, rows, make) {
  for (let y = 0; y < rows.length; y++)
    for (let x = 0; x < columns.length; x++) {
      const sum = [0, 0, 0];
      let weight = 0;
      for (const [sy, wy] of rows[y])
        for (const [sx, wx] of columns[x]) {
          for (let k = 0; k < 3; k++) sum[k] += wy * wx * image.data[3 * (sy * image.width + sx) + k];
          weight += wy * wx;
        }
      make(y * columns.length + x, sum.map((s) => Math.round(s / weight)));
    }
}

const sessions = {};
async function run(file, input) {
  sessions[file] ??= await ort.InferenceSession.create(path.join(onnx, 'nets', file),
    {intraOpNumThreads: 1, interOpNumThreads: 1, logSeverityLevel: 3});
  const session = sessions[file], {name, shape} = session.inputMetadata[0];
  const results = await session.run({[name]: new ort.Tensor('float32', input(shape), shape)});
  return {size: shape[1], ...Object.fromEntries(Object.entries(results).map(([key, t]) => [key, t.data]))};
}

async function linesOf(image, file) {
  const out = await run(file, ([, size]) => {
    const input = new Float32Array(size * size * 4);
    scaled(image, areas(image.width, size), areas(image.height, size), (i, rgb) => input.set([...rgb, 1], 4 * i));
    return input;
  });
  const map = out.size / 2, lines = [];
  for (let i = 0; i < map * map; i++) {
    const [x1, y1, x2, y2] = out.offsets.subarray(4 * i, 4 * i + 4);
    const length = Math.hypot(x2 - x1, y2 - y1) * 2;
    if (out.scores[i] < 0.2 - SCORE || length < 9) continue;
    const x = i % map, y = Math.floor(i / map), sx = image.width / map, sy = image.height / map;
    lines.push(Object.assign([out.scores[i], (x + x1) * sx, (y + y1) * sy, (x + x2) * sx, (y + y2) * sy],
      {sure: out.scores[i] >= 0.2 + SCORE && length >= 11}));
  }
  return lines;
}

/** The squares that are looked at, from the people that the run has found. */
function headsOf(people, image) {
  return people.map((box, i) => [box, i]).sort(([a, i], [b, j]) => b[3] - a[3] || i - j).slice(0, 4).map(([[x, y, w]]) => {
    const side = Math.min(Math.max(w, 16), image.width, image.height);
    const clamp = (v, most) => Math.min(Math.max(v, 0), most);
    return [clamp(x + Math.floor(w / 2) - Math.floor(side / 2), image.width - side), clamp(y - Math.floor(side / 4), image.height - side), side];
  });
}
function iou(a, b) {
  const w = Math.min(a[0] + a[2], b[0] + b[2]) - Math.max(a[0], b[0]);
  const h = Math.min(a[1] + a[3], b[1] + b[3]) - Math.max(a[1], b[1]);
  return w <= 0 || h <= 0 ? 0 : w * h / (a[2] * a[3] + b[2] * b[3] - w * h);
}
async function facesOf(image, file, people) {
  const faces = [];
  for (const [left, top, side] of headsOf(people, image)) {
    const out = await run(file, ([, size]) => {
      const input = new Float32Array(size * size * 3);
      scaled(image, neighbours(side, size, left), neighbours(side, size, top),
        (i, rgb) => input.set(rgb.map((v) => v / 127.5 - 1), 3 * i));
      return input;
    });
    const found = [];
    for (const [scores, boxes, cells, anchors] of
      [[out['Identity:0'], out['Identity_2:0'], 16, 2], [out['Identity_1:0'], out['Identity_3:0'], 8, 6]])
      for (let i = 0; i < scores.length; i++) {
        const score = 1 / (1 + Math.exp(-scores[i]));
        if (score < 0.5 - SCORE) continue;
        const cell = Math.floor(i / anchors), scale = side / out.size;
        const [dx, dy, w, h] = boxes.subarray(16 * i, 16 * i + 4).map((v) => v * scale);
        const x = left + side * (cell % cells + 0.5) / cells + dx, y = top + side * (Math.floor(cell / cells) + 0.5) / cells + dy;
        found.push([score, x - w / 2, y - h / 2, w, h]);
      }
    for (const face of found.sort((a, b) => b[0] - a[0]))
      if (!faces.some((f) => f.head === left && iou(f.slice(1), face.slice(1)) > 0.3)) faces.push(Object.assign(face, {head: left, sure: face[0] >= 0.5 + SCORE}));
  }
  return faces;
}

/** How many of `a` have their like in `b`. */
const found = (a, b, same) => a.filter((one) => b.some((other) => Math.abs(one[0] - other[0]) <= SCORE && same(one, other))).length;

(async () => {
  const scenes = JSON.parse(fs.readFileSync(path.join(folder, 'scenes.json')));
  const sameLine = (a, b) => [1, 3].every((i) => Math.hypot(a[i] - b[i], a[i + 1] - b[i + 1]) <= LINE_PIXELS);
  const sameFace = (a, b) => iou(a.slice(1), b.slice(1)) >= FACE_IOU;
  let frames = 0, bad = 0;
  const total = {faces: 0, lines: 0};
  for (const scene of scenes.frames) {
    const file = path.join(folder, `frame-${scene.frame}.ppm`);
    if (!fs.existsSync(file)) continue;
    const image = readPpm(file);
    frames++;
    for (const [kind, reference, same] of
      [['faces', await facesOf(image, scenes.faces, scene.people), sameFace], ['lines', await linesOf(image, scenes.lines), sameLine]]) {
      const ours = scene[kind], sure = reference.filter((one) => one.sure);
      const hit = found(sure, ours, same), told = found(ours, reference, same);
      total[kind] += sure.length;
      // A level of 255 more or less at the net's input moves the ends of a line, of one in fifty by more than a pixel of the map.
      const may = (all) => kind === 'lines' ? 1 + 0.02 * all.length : 0;
      if (sure.length - hit > may(sure) || ours.length - told > may(ours)) {
        bad++;
        console.log(`frame ${scene.frame}: ${hit} of ${sure.length} ${kind} of the reference are in the run, ${told} of ${ours.length} of the run in the reference`);
      }
    }
  }
  const good = bad === 0 && frames > 0 && total.faces > 0 && total.lines > 0;
  console.log(`perception: ${total.faces} faces and ${total.lines} lines in ${frames} frames, ${scenes.faces}, ${scenes.lines}: ${good ? 'as the reference has them' : 'NOT as the reference has them'}`);
  process.exit(good ? 0 : 1);
})().catch((error) => { console.error(`perception: ${error.message}`); process.exit(1); });
