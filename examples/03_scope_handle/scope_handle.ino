// A scope handle for Carina (docs/scope-handle.md): firmware sketch for boards with Arduino's libraries.
// An optical mouse sensor (PMW3360 or the like) looks at the shaft: dy is insertion, dx is roll. A 10 kOhm
// potentiometer is the lever, two push buttons to ground. Put your sensor's driver where READ_SENSOR says so.

const int PIN_LEVER = A0;
const int PIN_BUTTON[2] = {2, 3};
const float MM_PER_COUNT = 25.4f / 1600.0f;  // a sensor set to 1600 counts per inch
const float SHAFT_RADIUS_MM = 2.95f;         // half the shaft's diameter: turns counts into degrees
const unsigned long PERIOD_MS = 8;           // 125 samples a second

float insertion_mm = 0.0f, roll_deg = 0.0f;
unsigned int number = 0;
unsigned long due_ms = 0;
bool sending = false;

// READ_SENSOR: counts since the last call, along the shaft and across it.
void read_sensor(int *along, int *across) {
  *along = 0;
  *across = 0;
}

unsigned char crc8(const char *text) {
  unsigned char value = 0;
  while (*text) {
    value ^= (unsigned char)*text++;
    for (int bit = 0; bit < 8; bit++) value = value & 0x80 ? (value << 1) ^ 0x07 : value << 1;
  }
  return value;
}

void setup() {
  Serial.begin(115200);
  pinMode(PIN_BUTTON[0], INPUT_PULLUP);
  pinMode(PIN_BUTTON[1], INPUT_PULLUP);
}

void listen() {
  while (Serial.available()) {
    switch (Serial.read()) {
      case '?': Serial.println("# scope handle sketch 1"); break;
      case 'G': sending = true; break;
      case 'H': sending = false; break;
      case 'Z': insertion_mm = roll_deg = 0.0f; break;
    }
  }
}

void loop() {
  listen();
  int along, across;
  read_sensor(&along, &across);
  insertion_mm += along * MM_PER_COUNT;
  roll_deg += across * MM_PER_COUNT / SHAFT_RADIUS_MM * 57.29578f;
  if (!sending || (long)(millis() - due_ms) < 0) return;
  due_ms = millis() + PERIOD_MS;
  int lever = map(analogRead(PIN_LEVER), 0, 1023, -1000, 1000);
  int buttons = (digitalRead(PIN_BUTTON[0]) == LOW) | (digitalRead(PIN_BUTTON[1]) == LOW) << 1;
  char line[72];
  snprintf(line, sizeof line, "S,%u,%lu,%ld,%ld,%d,%X", number++ & 0xFFFF, millis(), lroundf(insertion_mm * 100),
           lroundf(roll_deg * 100), lever, buttons);
  Serial.print(line);
  snprintf(line, sizeof line, "*%02X", crc8(line));
  Serial.println(line);
}
