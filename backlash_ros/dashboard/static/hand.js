// Says to the server that a button is held, in a thread of its own: a page that draws must not stop the motion.

const BEAT = 50; // ms between two signs to the server
const BUSY = 1000; // ms that the page may say nothing; then it hangs, and would not see that the button was let go

let socket, heard, beat;

function end() {
  clearInterval(beat);
  if (socket) socket.onmessage = socket.onclose = null;
  socket?.close();
  socket = undefined;
}

function begin(address) {
  end();
  socket = new WebSocket(address);
  heard = performance.now();
  const sign = () => {
    if (performance.now() - heard > BUSY) {
      end();
      postMessage("The page was busy for too long: press again.");
    } else if (socket.readyState === WebSocket.OPEN) socket.send("held");
  };
  beat = setInterval(sign, BEAT);
  let why = "The dashboard does not answer: press again.";
  socket.onopen = sign;
  socket.onmessage = ({ data }) => (why = data);
  socket.onclose = () => {
    end();
    postMessage(why);
  };
}

onmessage = ({ data }) => {
  heard = performance.now();
  if (data === "let go") end();
  else if (data !== "held") begin(data);
};
