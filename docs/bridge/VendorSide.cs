// VendorSide.cs: the vendor's side of bladescan's bridge for a Cognex 3D-A5000 under VisionPro.
//
// UNTESTED: written without a camera and without VisionPro. It shows how little the bridge asks for; expect to mend names.
// Lines and files: docs/protocols/bridge.md. What each name rests on stands beside it:
//   [seen]    read in a public integration that drives a 3D-A5060 (JancsiTech/JancsiCamera, 2022); facts only, no code taken
//   [help]    named in VisionPro's public API documentation
//   [guess]   ours; look it up in your VisionPro
//
// Build: .NET Framework 4.8, x64, references to Cognex.VisionPro.dll, Cognex.VisionPro.Core.dll, Cognex.VisionPro.ImageFile.dll,
// System.Web.Extensions.dll (JSON). Start it from the bridge's config: command = ['VendorSide.exe', 'C:\bladescan\frames'].

using System;
using System.Collections.Generic;
using System.IO;
using System.Linq;
using System.Runtime.InteropServices;
using System.Web.Script.Serialization;
using Cognex.VisionPro;
using Fields = System.Collections.Generic.Dictionary<string, object>;

static class VendorSide
{
    static readonly JavaScriptSerializer Json = new JavaScriptSerializer { MaxJsonLength = 65536 };
    static string folder;
    static ICogAcqFifo fifo;
    static bool hdr;

    static int Main(string[] arguments)
    {
        folder = arguments[0];
        Directory.CreateDirectory(folder);
        foreach (var old in Directory.GetFiles(folder, "*.esm")) File.Delete(old);
        try { Open(); }
        catch (Exception trouble)
        {
            Say("fault", new Fields { { "text", trouble.Message } });
            return 1;
        }
        string line;
        // The bridge closes our standard input when it wants us gone.
        while ((line = Console.In.ReadLine()) != null)
        {
            var order = Json.Deserialize<Fields>(line);
            switch ((string)order["do"])
            {
                case "configure": Configure(Convert.ToInt32(order["config_id"]), (Fields)order["settings"]); break;
                case "acquire": Acquire(Convert.ToInt32(order["acquisition"])); break;
                case "status": Say("status", new Fields()); break; // names of temperature properties are unknown
                case "abort": break; // Acquire waits; what comes late is passed over by the bridge
                case "end": return 0;
            }
        }
        return 0;
    }

    static void Open()
    {
        // [seen] the camera is an imaging device whose name contains "Device: 3D-A".
        ICogFrameGrabber grabber = new CogFrameGrabberImagingDevices().Cast<ICogFrameGrabber>()
            .First(candidate => candidate.Name.Contains("Device: 3D-A"));
        // [seen] video format "Cognex NullFormat"; the pixel format is ignored.
        fifo = grabber.CreateAcqFifo("Cognex NullFormat", CogAcqFifoPixelFormatConstants.Format8Grey, 0, true);
        Set("cuda_device", 0); // [seen] must be set before any other property, else the FIFO is invalid
        Set("acquisition_mode", "esm_data"); // [seen] the other one is "range_image"
        fifo.Timeout = 15000; // [help] ms; the default is 10,000
        // [help] missed triggers are ignored by default; they must not be. The name of the switch is a [guess].
        Set("ignore_missed_trigger", false);
        // [help] MovePart: exposures are over, the part may move. Whether this adapter fires it is unknown: if it does, set
        // says_exposed to true below.
        fifo.MovePart += (sender, arguments) => { };
        Say("ready", new Fields {
            { "vendor", "Cognex" }, { "model", ModelOf(grabber.Name) }, { "serial", grabber.SerialNumber }, // [help]
            { "sdk_version", typeof(ICogAcqFifo).Assembly.GetName().Version.ToString() }, { "says_exposed", false },
        });
    }

    static string ModelOf(string name)
    {
        return name.Substring(name.IndexOf("3D-A", StringComparison.Ordinal)).Split(' ', ',')[0];
    }

    static void Configure(int configId, Fields settings)
    {
        try
        {
            Func<string, double> number = name => Convert.ToDouble(settings[name]);
            Func<string, string> word = name => Capital((string)settings[name]);
            bool binning = (bool)settings["binning"];
            Set("binning", binning); // [seen] halves width and height; the region is ignored while it is on
            if (!binning)
            {
                var roi = ((System.Collections.ArrayList)settings["roi_px"]).Cast<object>().Select(Convert.ToInt32).ToArray();
                Set("width", roi[0]); Set("height", roi[1]); // [guess]
                Set("camera_1_offset_x", roi[2]); Set("camera_1_offset_y", roi[3]); // [seen]
                Set("camera_2_offset_x", roi[4]); Set("camera_2_offset_y", roi[5]); // [seen]
            }
            Set("exposure", number("exposure_us") / 1000.0); // [seen] ms
            Set("image_count", (int)number("image_count")); // [seen] 12 to 60
            hdr = number("hdr_low_us") > 0 || number("hdr_high_us") > 0;
            Set("hdr_exposure_low", number("hdr_low_us") / 1000.0); // [guess] the passes are [seen], their names not
            Set("hdr_exposure_high", number("hdr_high_us") / 1000.0); // [guess]
            Set("gradation_compression", word("compression")); // [seen] None, Low, Medium, High
            Set("led_brightness", (int)number("led_percent")); // [seen] percent; above 25 the device pauses to cool down
            Set("frame_time_exposure_ratio", number("frame_time_ratio")); // [seen] 1.0 to 4.0, expert mode
            Set("score_threshold", number("score_threshold")); // [seen] 0 to 1
            Set("outlier_filter", word("outlier_filter")); // [seen] Disabled, Permissive, Balanced, Strict
            Set("reconstruction_quality", (int)number("reconstruction_quality")); // [seen] 0 to 9
            Set("pre_filtering", (int)number("pre_filtering")); // [seen] 0 to 9
            Set("working_volume", word("working_volume")); // [seen] Standard, Extended
            Set("volume_of_interest", false); // [seen] the bridge cuts the volume itself
            fifo.Prepare(); // [help]
            Say("configured", new Fields { { "config_id", configId } });
        }
        catch (Exception trouble)
        {
            Say("error", new Fields { { "config_id", configId }, { "code", CodeOf(trouble) }, { "text", trouble.Message } });
        }
    }

    static void Acquire(int acquisition)
    {
        try
        {
            // [seen] integrators let it run freely and switch triggers on for one frame; HDR needs the manual model.
            fifo.OwnedTriggerParams.TriggerModel = CogAcqTriggerModelConstants.Manual; // [help]
            int ticket = fifo.StartAcquire(); // [help]
            int number;
            var image = fifo.CompleteAcquire(ticket, out ticket, out number); // [help] waits
            string path = Path.Combine(folder, acquisition + ".esm");
            WriteEsm(image, path);
            Say("frame", new Fields { { "acquisition", acquisition }, { "esm", path } });
        }
        catch (Exception trouble)
        {
            Say("error", new Fields {
                { "acquisition", acquisition }, { "code", CodeOf(trouble) },
                { "vendor_code", trouble.HResult }, { "text", trouble.Message },
            });
        }
    }

    // [seen] In mode "esm_data" the image is one block of memory: header, then points (docs/protocols/bridge.md, 5.1).
    // How VisionPro hands its address out is a [guess]: the pixels of an 8-bit grey image.
    static void WriteEsm(ICogImage image, string path)
    {
        var grey = (CogImage8Grey)image;
        ICogImage8PixelMemory memory =
            grey.Get8GreyPixelMemory(CogImageDataModeConstants.Read, 0, 0, grey.Width, grey.Height); // [help]
        try
        {
            var block = new byte[(long)memory.Stride * grey.Height];
            Marshal.Copy(memory.Scan0, block, 0, block.Length);
            File.WriteAllBytes(path, block); // closed before "frame" is said
        }
        finally { memory.Dispose(); }
    }

    static void Set(string name, object value)
    {
        fifo.OwnedCustomPropertiesParams.CustomProps.Add(new CogAcqCustomProperty(name, Convert.ToString(
            value, System.Globalization.CultureInfo.InvariantCulture), "")); // [help] properties are set by name
    }

    static string Capital(string word) { return char.ToUpperInvariant(word[0]) + word.Substring(1); }

    // [help] VisionPro's exceptions, by their names, to codes of A3DP/1.
    static int CodeOf(Exception trouble)
    {
        string name = trouble.GetType().Name;
        if (name.Contains("Timeout")) return 402;
        if (name.Contains("Missed") || name.Contains("Overrun")) return 401;
        if (name.Contains("HardwareInUse")) return 503;
        if (name.Contains("InvalidROI")) return 301;
        if (name.Contains("TooManyStarts")) return 204;
        return 500;
    }

    static void Say(string what, Fields fields)
    {
        fields["is"] = what;
        Console.Out.Write(Json.Serialize(fields) + "\n");
        Console.Out.Flush();
    }
}
