#version 300 es
precision mediump float;
// The newest picture of the airway; round, as the scope's, where it is round on the screen.
uniform sampler2D picture;
uniform bool is_round;
in vec2 at;
out vec4 colour;

void main() {
  if (is_round && dot(at, at) > 1.0) discard;
  // A picture's first row is its upper one.
  colour = vec4(texture(picture, vec2(0.5 + 0.5 * at.x, 0.5 - 0.5 * at.y)).rgb, 1.0);
}
