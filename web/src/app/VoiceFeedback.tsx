/** Spoken feedback of an attempt by a voice of this computer; off by default, and absent without such a voice. */

import { useEffect, useRef, useState } from "react";
import { localVoice, speechAfter } from "../state/voice";
import type { RunningTask } from "../wire/messages";
import { useApp, useStation } from "./context";
import { SwitchKey } from "./controls";

/** Return a voice of this computer; null without one, or before the browser has listed its voices. */
function useLocalVoice(): SpeechSynthesisVoice | null {
  const [voice, setVoice] = useState<SpeechSynthesisVoice | null>(null);
  useEffect(() => {
    const speech = window.speechSynthesis as SpeechSynthesis | undefined;
    if (speech === undefined) return;
    const read = () => setVoice(localVoice(speech.getVoices()));
    read();
    speech.addEventListener?.("voiceschanged", read);
    return () => speech.removeEventListener?.("voiceschanged", read);
  }, []);
  return voice;
}

/** Render the switch of the voice; nothing without a voice of this computer. */
export function VoiceSwitch() {
  const station = useStation();
  const on = useApp((state) => state.ui.voiceOn);
  const voice = useLocalVoice();
  if (voice === null) return null;
  return (
    <SwitchKey
      label="Voice"
      words={on ? "Stop speaking" : "Speak the next step and touches during a task, by a voice of this computer"}
      on={on}
      testId="voice"
      onChange={() => station.ui({ voiceOn: !on })}
    />
  );
}

/** Speak the feedback of the running attempt while the voice is on; render nothing. */
export function VoiceFeedback({ running }: { running: RunningTask }) {
  const on = useApp((state) => state.ui.voiceOn);
  const voice = useLocalVoice();
  const before = useRef<RunningTask | null>(null);
  const spokenStep = useRef<string | null>(null);
  useEffect(() => {
    if (!on || voice === null) {
      // The voice begins with the next step when it is switched on, or when the browser has listed its voices.
      before.current = null;
      return;
    }
    const { text, step } = speechAfter(before.current, running, spokenStep.current);
    before.current = running;
    spokenStep.current = step;
    if (text === null) return;
    const utterance = new SpeechSynthesisUtterance(text);
    utterance.voice = voice;
    utterance.lang = voice.lang;
    // The newest event replaces what is not spoken yet.
    window.speechSynthesis.cancel();
    window.speechSynthesis.speak(utterance);
  }, [on, voice, running]);
  useEffect(() => () => (window.speechSynthesis as SpeechSynthesis | undefined)?.cancel(), []);
  return null;
}
