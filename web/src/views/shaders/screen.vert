#version 300 es
// A flat screen in the room: two triangles, placed and seen by one eye.
uniform mat4 eye_from_screen;
const vec2 CORNERS[4] = vec2[4](vec2(-1.0, -1.0), vec2(1.0, -1.0), vec2(-1.0, 1.0), vec2(1.0, 1.0));
out vec2 at;

void main() {
  vec2 corner = CORNERS[gl_VertexID];
  at = corner;
  gl_Position = eye_from_screen * vec4(corner, 0.0, 1.0);
}
