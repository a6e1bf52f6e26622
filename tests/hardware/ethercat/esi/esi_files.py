"""ESI files for tests: a drive, a terminal and a drive with modules, as ETG.2000 structures them."""

from pathlib import Path

DRIVE = """<?xml version="1.0" encoding="UTF-8"?>
<EtherCATInfo Version="1.6">
  <Vendor><Id>#x00000ABC</Id><Name LcId="1031">Beispiel</Name><Name LcId="1033">Example Drives</Name>
    <ImageData16x14>424D</ImageData16x14></Vendor>
  <Descriptions>
    <Groups><Group><Type>Drives</Type><Name>Drives</Name></Group></Groups>
    <Devices>
      <Device Physics="YY">
        <Type ProductCode="#x00001234" RevisionNo="#x00010000">SD-10</Type>
        <Name LcId="1033">Servo drive 10 A, first revision</Name>
        <RxPdo Fixed="1" Sm="2"><Index>#x1600</Index><Name>Speed</Name>
          <Entry><Index>#x6040</Index><SubIndex>0</SubIndex><BitLen>16</BitLen><Name>Control</Name></Entry>
        </RxPdo>
        <Mailbox><CoE/></Mailbox>
      </Device>
      <Device Physics="YY">
        <Type ProductCode="#x00001234" RevisionNo="#x00020000">SD-10</Type>
        <Name LcId="1031">Servoregler</Name><Name LcId="1033"><![CDATA[Servo drive <10 A>]]></Name>
        <Info><StateMachine><Timeout><PreopTimeout>3000</PreopTimeout>
          <SafeopOpTimeout>9000</SafeopOpTimeout></Timeout></StateMachine></Info>
        <Profile><ProfileNo>402</ProfileNo><Dictionary>
          <DataTypes><DataType><Name>UINT</Name><BitSize>16</BitSize></DataType></DataTypes>
          <Objects>
            <Object><Index>#x6040</Index><Name>Control</Name><Type>UINT</Type></Object>
            <Object><Index>#x6041</Index></Object><Object><Index>#x605B</Index></Object>
            <Object><Index>#x605E</Index></Object><Object><Index>#x6071</Index></Object>
            <Object><Index>#x6072</Index></Object><Object><Index>#x6076</Index></Object>
          </Objects></Dictionary></Profile>
        <Fmmu>Outputs</Fmmu><Fmmu>Inputs</Fmmu>
        <Sm StartAddress="#x1000" ControlByte="#x26" DefaultSize="128" Enable="1">MBoxOut</Sm>
        <Sm StartAddress="#x1080" ControlByte="#x22" DefaultSize="128" Enable="1">MBoxIn</Sm>
        <Sm StartAddress="#x1100" ControlByte="#x24" Enable="1">Outputs</Sm>
        <Sm StartAddress="#x1180" ControlByte="#x20" Enable="1">Inputs</Sm>
        <RxPdo Sm="2"><Index>#x1600</Index><Name>Position</Name><Exclude>#x1601</Exclude>
          <Entry><Index>#x6040</Index><SubIndex>0</SubIndex><BitLen>16</BitLen><Name>Control</Name></Entry>
          <Entry><Index>#x607A</Index><SubIndex>0</SubIndex><BitLen>32</BitLen><Name>Target</Name></Entry>
        </RxPdo>
        <RxPdo><Index>#x1601</Index><Name>Torque</Name><Exclude>#x1600</Exclude>
          <Entry><Index>#x6040</Index><SubIndex>0</SubIndex><BitLen>16</BitLen><Name>Control</Name></Entry>
          <Entry><Index>#x6071</Index><SubIndex>#x0</SubIndex><BitLen>16</BitLen><Name>Torque</Name></Entry>
          <Entry><Index>#x6060</Index><SubIndex>0</SubIndex><BitLen>8</BitLen><Name>Mode</Name></Entry>
          <Entry><Index>0</Index><BitLen>8</BitLen></Entry>
        </RxPdo>
        <RxPdo Fixed="true"><Index>#x1602</Index><Name>Outputs of the drive</Name><ExcludedSm>2</ExcludedSm>
          <Entry><Index>#x60FE</Index><SubIndex>1</SubIndex><BitLen>32</BitLen><Name>Outputs</Name></Entry>
        </RxPdo>
        <TxPdo Mandatory="1" Fixed="1" Sm="3"><Index>#x1A00</Index><Name>Actual values</Name>
          <Entry><Index>#x6041</Index><SubIndex>0</SubIndex><BitLen>16</BitLen><Name>Status</Name></Entry>
          <Entry><Index>#x6064</Index><SubIndex>0</SubIndex><BitLen>32</BitLen><Name>Position</Name></Entry>
        </TxPdo>
        <TxPdo><Index>#x1A01</Index><Name>Torque</Name>
          <Entry><Index>#x6077</Index><SubIndex>0</SubIndex><BitLen>16</BitLen><Name>Torque</Name></Entry>
        </TxPdo>
        <Mailbox DataLinkLayer="1"><CoE SdoInfo="1" PdoAssign="1" PdoConfig="true">
          <InitCmd><Transition>PS</Transition><Index>#x6060</Index><SubIndex>0</SubIndex><Data>08</Data></InitCmd>
          <InitCmd><Transition>PS</Transition><Index>#x605E</Index><SubIndex>0</SubIndex><Data>0200</Data></InitCmd>
          <InitCmd Fixed="1"><Transition>PS</Transition><Index>#x2100</Index><SubIndex>#x1A</SubIndex>
            <Data>FDff</Data><Comment>Filter</Comment></InitCmd>
          <InitCmd><Transition>SO</Transition><Index>#x2101</Index><SubIndex>0</SubIndex><Data>01</Data></InitCmd>
          <InitCmd><Transition>PS</Transition><Index>#x1C32</Index><SubIndex>1</SubIndex><Data>0200</Data></InitCmd>
          <InitCmd><Transition>PI</Transition><Index>#x2102</Index><SubIndex>0</SubIndex><Data>01</Data></InitCmd>
        </CoE><FoE/></Mailbox>
        <Dc><OpMode><Name>DC</Name><Desc>SYNC0</Desc><AssignActivate>#x300</AssignActivate>
            <CycleTimeSync0 Factor="1">0</CycleTimeSync0></OpMode>
          <OpMode><Name>Free run</Name></OpMode></Dc>
        <Eeprom><ByteSize>2048</ByteSize></Eeprom>
      </Device>
    </Devices>
  </Descriptions>
</EtherCATInfo>
"""
"""A drive with two revisions."""

TERMINAL = """<EtherCATInfo><Vendor><Id>2</Id></Vendor><Descriptions><Devices>
<Device><Type ProductCode="305419896">T-1</Type><Name>Digital inputs</Name>
<TxPdo Fixed="1" Sm="0"><Index>#x1A00</Index><Name>Inputs</Name>
<Entry><Index>#x6000</Index><SubIndex>1</SubIndex><BitLen>8</BitLen><Name>Inputs</Name></Entry></TxPdo></Device>
</Devices></Descriptions></EtherCATInfo>"""
"""A terminal without mailbox, whose only PDO is in sync manager 0."""

MODULAR = """<EtherCATInfo><Vendor><Id>#xABD</Id><Name>Axes</Name></Vendor><Descriptions><Devices>
<Device><Type ProductCode="#x7" RevisionNo="#x1">Axis</Type><Name>Axis with slots</Name>
<Mailbox><CoE PdoAssign="1"/></Mailbox>
<Slots MaxSlotCount="1"><Slot><ModuleIdent Default="1">#x10</ModuleIdent></Slot></Slots></Device></Devices>
<Modules><Module><Type ModuleIdent="#x10">cst</Type><Name>Torque</Name>
<RxPdo Fixed="1" Sm="2"><Index DependOnSlot="1">#x1600</Index><Name>cst</Name>
<Entry><Index DependOnSlot="1">#x6040</Index><SubIndex>0</SubIndex><BitLen>16</BitLen></Entry>
<Entry><Index>#x6071</Index><SubIndex>0</SubIndex><BitLen>16</BitLen></Entry></RxPdo>
<TxPdo Fixed="1" Sm="3"><Index>#x1A00</Index><Name>cst</Name>
<Entry><Index>#x6041</Index><SubIndex>0</SubIndex><BitLen>16</BitLen></Entry>
<Entry><Index>#x6064</Index><SubIndex>0</SubIndex><BitLen>32</BitLen></Entry></TxPdo>
<Mailbox><CoE><InitCmds><InitCmd><Transition>PS</Transition><Index>#x2000</Index><SubIndex>0</SubIndex>
<Data>01</Data></InitCmd></InitCmds></CoE></Mailbox></Module></Modules>
</Descriptions></EtherCATInfo>"""
"""A device whose PDOs are those of a module."""

SAMPLES = (DRIVE, TERMINAL, MODULAR)


def written(folder: Path, text: str | bytes, name: str = "drive.xml") -> Path:
    """The file with this text."""
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode("utf-8"))
    return path
